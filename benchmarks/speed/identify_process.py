"""Identifies campaigns in a process of its own; prints errors as JSON.

Run: python identify_process.py [--physics] FOLDER…

With --physics no compensator is trained.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from hitchid._support.jax_setup import prepare_jax


def main(folders: Sequence[Path], *, physics: bool) -> None:
    """Read campaigns, identify one by `identify` or several by `identify_many`, tell each one's errors."""
    prepare_jax()
    from hitchid import identification
    from hitchid.identification import CompensatorConfig
    from hitchid.identification.identify import PAPER_SPECS
    from hitchid.logs import read

    options = {
        "structure": PAPER_SPECS,
        "training": None if physics else CompensatorConfig(free_run=None),
        "rivals": None,
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
    parser = argparse.ArgumentParser()
    parser.add_argument("--physics", action="store_true")
    parser.add_argument("folders", type=Path, nargs="+")
    arguments = parser.parse_args()
    main(arguments.folders, physics=arguments.physics)
