"""Identifies campaigns in a process of its own: python identify_process.py FOLDER…; prints errors as JSON."""

import json
import sys
from pathlib import Path

from hitchid._support.compilation_cache import prepare_jax


def main(folders: list[Path]) -> None:
    """Read campaigns, identify one by `identify` or several by `identify_many`, tell each one's errors."""
    prepare_jax()
    from hitchid import identification
    from hitchid.identification import CompensatorConfig
    from hitchid.identification.identify import PAPER_SPECS
    from hitchid.readers import read

    options = {
        "structure": PAPER_SPECS,
        "training": CompensatorConfig(free_run=None, baselines=False),
        "comparison": None,
    }
    campaigns = [read(folder) for folder in folders]
    if len(campaigns) == 1:
        identifications = (identification.identify(campaigns[0], **options),)
    else:
        identifications = identification.identify_many(campaigns, **options)
    errors = [
        {direction: result.channels[direction].phase1.rmse for direction in result.channels}
        for result in identifications
    ]
    sys.stdout.write(json.dumps(errors))


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
