"""Where the time of an identification goes: `python -m benchmarks.where_time_goes SET…`.

Each set of `HITCHID_DATA` is identified twice in processes of their own, first with nothing compiled before,
then with the programs of the first in the cache. Of both it prints the time until the physics model is there
and until the whole model is, processor time, the largest memory, how long tracing, lowering and compiling
took, and of the programs that took longest number and seconds. Times of compiling are sums over threads.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from threading import Lock

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
SHOWN = 20  # programs, those that took longest
STEPS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowering",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
CHILD = "--in-this-process"


def main() -> None:
    """Identify each set twice and print where the time went."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.where_time_goes", description=__doc__)
    parser.add_argument("sets", nargs="+", help="names of folders of HITCHID_DATA, or folders of logs")
    parser.add_argument(CHILD, action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.in_this_process:
        sys.stdout.write(json.dumps(_measured(arguments.sets[0])))
        return
    for name in arguments.sets:
        with tempfile.TemporaryDirectory() as cache:
            for label in ("nothing compiled before", "compiled before"):
                command = [sys.executable, "-m", "benchmarks.where_time_goes", name, CHILD]
                environment = {**os.environ, "XDG_CACHE_HOME": cache, "OPENBLAS_NUM_THREADS": "1"}
                started = time.perf_counter()
                done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)  # noqa: S603
                _show(name, label, time.perf_counter() - started, json.loads(done.stdout))


def _measured(name: str) -> dict:
    """Return what one identification took, as the command line does it."""
    from hitchid._support.jax_setup import prepare_jax

    prepare_jax()
    from jax import monitoring

    steps: dict[str, list[float]] = defaultdict(lambda: [0, 0.0])
    programs: dict[str, list[float]] = defaultdict(lambda: [0, 0.0])
    lock = Lock()

    def listen(event: str, seconds: float, **details: object) -> None:
        if event not in STEPS:
            return
        with lock:
            counted = [steps[STEPS[event]]]
            if STEPS[event] == "compiling":
                counted.append(programs[str(details.get("fun_name", "?"))])
            for entry in counted:
                entry[0] += 1
                entry[1] += seconds

    monitoring.register_event_duration_secs_listener(listen)
    import hitchid

    folder = DATA / name if (DATA / name).is_dir() else Path(name)
    started, seconds = time.perf_counter(), {}
    campaign = hitchid.read(folder)
    seconds["read"] = time.perf_counter() - started

    def on_physics(_: object) -> str:
        seconds["physics model"] = time.perf_counter() - started
        return ""

    identification = hitchid.identify(campaign, on_physics=on_physics)
    seconds["whole model"] = time.perf_counter() - started
    return {
        "seconds": seconds,
        "stages": {name: dict(trace.seconds) for name, trace in identification.channels.items()},
        "processor": time.process_time(),
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "steps": steps,
        "programs": programs,
    }


def _show(name: str, label: str, wall_s: float, measured: dict) -> None:
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in measured["seconds"].items())
    lines = [
        f"## {name}, {label}",
        "",
        f"process {wall_s:.1f} s, from its logs on: {seconds} s; processor {measured['processor']:.1f} s, "
        f"largest memory {measured['memory']:.0f} MiB",
        "",
        "| step or program | number | s |",
        "| --- | ---: | ---: |",
    ]
    longest = sorted(measured["programs"].items(), key=lambda entry: -entry[1][1])[:SHOWN]
    for entry, (number, taken) in [*measured["steps"].items(), *longest]:
        lines.append(f"| {entry} | {number} | {taken:.1f} |")
    directions = measured["stages"]
    lines += ["", f"| stage, s | {' | '.join(directions)} |", "| --- |" + " ---: |" * len(directions)]
    names = dict.fromkeys(stage for stages in directions.values() for stage in stages)
    for stage in names:
        cells = " | ".join(f"{stages.get(stage, 0.0):.1f}" for stages in directions.values())
        lines.append(f"| {stage} | {cells} |")
    sys.stdout.write("\n".join(lines) + "\n\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
