"""Identifies campaigns in a process of its own: python identify_process.py FOLDER…; prints errors as JSON."""

import json
import sys
from pathlib import Path

from hitchid.cli.cache import prepare_jax


def main(folders: list[Path]) -> None:
    """Read campaigns, identify one by `identify` or several by `identify_many`, tell each one's errors."""
    prepare_jax()
    from hitchid import identification
    from hitchid.identification import Training
    from hitchid.identification.identify import PAPER_FORMS
    from hitchid.readers import read

    asked = {
        "structure": PAPER_FORMS,
        "training": Training(rollouts=None, baselines=False),
        "comparison": None,
    }
    campaigns = [read(folder) for folder in folders]
    if len(campaigns) == 1:
        found = (identification.identify(campaigns[0], **asked),)
    else:
        found = identification.identify_many(campaigns, **asked)
    errors = [{mode: each.channels[mode].phase1.rmse for mode in each.channels} for each in found]
    sys.stdout.write(json.dumps(errors))


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
