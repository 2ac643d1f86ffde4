"""Plausible faults, put into a copy of the tree one at a time: does a test of the room find each?

    python benchmarks/mutations.py                     # by `make test`, that is without the long tests
    python benchmarks/mutations.py --all               # by every test of the rooms
    python benchmarks/mutations.py --tree other/tree   # the same faults in another tree, by its own tests
    python benchmarks/mutations.py --only spikes       # those whose file contains a text

A fault is written as old and new text of one file; each old text is in its file exactly once. The tests are
also run without a fault, unless `--unchecked`: a test that fails then too has found nothing.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COPIED = ("src", "tests", "docs", "examples", "benchmarks", "pyproject.toml", "README.md", "LICENSE")
PASSED, FAILED = 0, 1  # exit codes of pytest
LONGEST_S = 1200


class Mutation(NamedTuple):
    """A fault.

    Attributes:
        file: below src/hitchid.
        old: text that is replaced.
        new: text that replaces it.
        nearest: the file below tests that is the first to look; the folder of the room follows.
    """

    file: str
    old: str
    new: str
    nearest: str

    @property
    def paths(self) -> list[str]:
        """Return the tests that should find it."""
        return [f"tests/{self.nearest}", f"tests/{self.file.partition('/')[0]}"]


MUTATIONS = (
    Mutation(
        "_support/metrics.py",
        "leave_one_out = np.sqrt((sums.sum() - sums) / (counts.sum() - counts))",
        "leave_one_out = np.sqrt((sums.sum() - sums) / counts.sum())",
        "_support/test_metrics.py",
    ),
    Mutation("_support/files.py", "if path != folder / MANIFEST_FILE", "if True", "_support/test_storage.py"),
    Mutation(
        "logs/units.py",
        "source.factor / wanted.factor",
        "wanted.factor / source.factor",
        "logs/test_units.py",
    ),
    Mutation(
        "logs/kinds.py",
        "(command > on) | (command <= off)",
        "(command > on) | (command <= on)",
        "logs/test_segmentation.py",
    ),
    Mutation(
        "logs/formats/can_decoder.py",
        "* signal.scale + signal.offset",
        "* signal.scale - signal.offset",
        "logs/test_can.py",
    ),
    Mutation(
        "logs/formats/can_decoder.py",
        "all_ones - 1 if signal.length < 8",
        "all_ones if signal.length < 8",
        "logs/test_can.py",
    ),
    Mutation("logs/content.py", "MAX_UNPACK_RATIO * path.stat()", "1e9 * path.stat()", "test_fuzz.py"),
    Mutation(
        "logs/audit/resolution.py",
        "JUMP_FACTOR * neighbour_steps.max(axis=1)",
        "neighbour_steps.min(axis=1)",
        "logs/audit/test_audit_sensor.py",
    ),
    Mutation(
        "logs/audit/command_checks.py",
        "< -CLEAR_OF_TYPICAL * typical",
        "> CLEAR_OF_TYPICAL * typical",
        "logs/audit/test_audit_campaign.py",
    ),
    Mutation(
        "bench/linkage.py", "self.dead_volume + self.hose_volume", "self.dead_volume", "bench/test_motion.py"
    ),
    Mutation("logs/motion.py", "command[: command.size - lag]", "command[lag:]", "logs/test_propose.py"),
    Mutation(
        "networks/lstm.py",
        "gates = gates + cast(Array, cell.bias)",
        "gates = gates - cast(Array, cell.bias)",
        "networks/test_lstm.py",
    ),
    Mutation(
        "structures/nonlinearity.py",
        "0.5 * hysteresis * dead_zone",
        "hysteresis * dead_zone",
        "structures/test_static_nonlinearity.py",
    ),
    Mutation(
        "structures/discretisation.py",
        "(position / STROKE_RANGE + 1)",
        "(position / STROKE_RANGE - 1)",
        "structures/test_stroke_dynamics.py",
    ),
    Mutation(
        "estimation/least_squares.py", "damping * scale)", "damping / scale)", "estimation/test_search.py"
    ),
    Mutation(
        "estimation/correlations.py",
        "(test_indices.size * counts[test_indices, None])",
        "test_indices.size",
        "estimation/test_correlations.py",
    ),
    Mutation(
        "baselines/linear.py",
        "sliding_window_view(padded, order)[:, ::-1]",
        "sliding_window_view(padded, order)",
        "baselines/test_autoregression.py",
    ),
    Mutation("model/limits.py", "self.upper - tolerance", "self.upper + tolerance", "model/test_limits.py"),
    Mutation(
        "model/load_filter.py",
        "self.noise**2 + self.drift**2 * step_s",
        "self.noise**2 - self.drift**2 * step_s",
        "model/test_load_filter.py",
    ),
    Mutation("uncertainty/conformal.py", "level / (1.0 - level)", "level", "uncertainty/test_bands.py"),
    Mutation(
        "uncertainty/parameter_result.py",
        "upper < 1 / nyquist_rad_s",
        "upper > 1 / nyquist_rad_s",
        "uncertainty/test_verdict.py",
    ),
    Mutation(
        "identification/dead_zone.py",
        "values.std(ddof=1)",
        "values.std(ddof=0)",
        "identification/test_dead_zone.py",
    ),
    Mutation(
        "identification/hold_drift.py",
        "edges[::2] + settling_samples",
        "edges[::2]",
        "identification/test_hold_drift.py",
    ),
    Mutation(
        "validation/acceptance.py",
        "return minimum <= value <= maximum",
        "return minimum <= value",
        "validation/test_acceptance.py",
    ),
    Mutation(
        "control/loops.py",
        "* np.diff(phase, axis=-1)) + 180.0",
        "* np.diff(phase, axis=-1))",
        "control/test_margins.py",
    ),
    Mutation(
        "live/live.py",
        "if samples > MAX_GAP_SAMPLES:",
        "if samples >= MAX_GAP_SAMPLES:",
        "live/test_live.py",
    ),
    Mutation(
        "fleet/random_effects.py",
        "false_discovery_control(p_values[tested])",
        "p_values[tested]",
        "fleet/test_random_effects.py",
    ),
    Mutation(
        "export/constants.py",
        "(fraction * step_s, (1 - fraction) * step_s)",
        "((1 - fraction) * step_s, fraction * step_s)",
        "export/test_parity.py",
    ),
    Mutation("report/svg.py", 'aria-label="{html_text(alt)}"', 'aria-label="{alt}"', "report/test_svg.py"),
    Mutation(
        "hmi/safety.py",
        "self.is_attended and now_s - self.page_s >",
        "self.is_attended and self.page_s - now_s >",
        "hmi/test_safety.py",
    ),
)


def apply(mutation: Mutation, tree: Path) -> str:
    """Write a fault into a tree; return the text without it."""
    path = tree / "src" / "hitchid" / mutation.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutation.old) != 1:
        raise SystemExit(
            f"{mutation.file}: {mutation.old!r} is there {text.count(mutation.old)} times, expected 1"
        )
    path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
    return text


def run_tests(
    tree: Path, paths: list[str], options: list[str], environment: dict[str, str]
) -> tuple[int, str]:
    """Return the exit code of the tests, and the first that failed."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *options, *paths]
    done = subprocess.run(  # noqa: S603
        command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=False
    )
    if done.returncode not in (PASSED, FAILED):
        raise SystemExit(
            f"{' '.join(paths)}: the tests could not be run\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    lines = done.stdout.splitlines()
    return done.returncode, next((line for line in lines if line.startswith(("FAILED", "ERROR"))), "")


def main() -> None:
    """Try every fault and print which are found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tree", type=Path, default=ROOT, help="the tree whose code and tests are taken")
    parser.add_argument("--all", action="store_true", help="run the long tests too")
    parser.add_argument("--unchecked", action="store_true", help="do not run the tests without a fault")
    parser.add_argument("--only", default="", help="faults whose file contains this text")
    arguments = parser.parse_args()
    mutations = [mutation for mutation in MUTATIONS if arguments.only in mutation.file]
    tiered = "long:" in (arguments.tree / "pyproject.toml").read_text(encoding="utf-8")
    options = ["-n", "0", *(["-m", "not long"] if tiered and not arguments.all else [])]
    caught = 0
    with TemporaryDirectory(prefix="hitchid-mutations-") as place:
        tree = Path(place) / "tree"
        tree.mkdir()
        for name in COPIED:
            source = arguments.tree / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, tree / name)
        environment = {
            **os.environ,
            "PYTHONPATH": str(tree / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "JAX_COMPILATION_CACHE_DIR": str(Path(place) / "compiled"),
            "HITCHID_DATA": os.environ.get(
                "HITCHID_DATA", str(arguments.tree.resolve().parent / "shared" / "data")
            ),
        }
        passing: set[str] = set()
        for mutation in mutations:
            untried = [path for path in mutation.paths if path not in passing]
            if untried and not arguments.unchecked:
                code, first = run_tests(tree, untried, options, environment)
                if code != PASSED:
                    raise SystemExit(f"without a fault: {first}")
                passing |= set(untried)
            begun = time.monotonic()
            text = apply(mutation, tree)
            code, first = run_tests(tree, mutation.paths, options, environment)
            (tree / "src" / "hitchid" / mutation.file).write_text(text, encoding="utf-8")
            caught += code == FAILED
            verdict = "caught" if code == FAILED else "MISSED"
            row = f"{verdict}  {time.monotonic() - begun:5.0f} s  {mutation.file}: {mutation.new}"
            sys.stdout.write(f"{row}\n{'':18}{first}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{caught} of {len(mutations)} caught\n")


if __name__ == "__main__":
    main()
