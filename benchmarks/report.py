"""How long a report takes after its validation: `python benchmarks/report.py MODEL LOGS [RUNS]`."""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import hitchid
from hitchid.model import load_trace
from hitchid.report import read_trace, write_report


def main(model_folder: str, logs: str, runs: int) -> None:
    """Print the median time of composing and writing a report, s, and the size of its page."""
    model, campaign = hitchid.load(model_folder), hitchid.read(logs)
    trace = read_trace(load_trace(model_folder))
    result = hitchid.validate(model, campaign)
    seconds, size = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(runs):
            started = time.perf_counter()
            document = result.report(trace=trace)
            out = Path(folder) / str(number)
            write_report(out, document, result.files(), mark="metrics.json")
            seconds.append(time.perf_counter() - started)
            size = (out / "report.html").stat().st_size
    timing_text = f"median {statistics.median(seconds):.1f} s of {runs}, first {seconds[0]:.1f} s"
    sys.stdout.write(f"{len(campaign.records)} logs, {len(list(document.pictures))} figures: {timing_text}; ")
    sys.stdout.write(f"page {size / 1e6:.2f} MB\n")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 3)
