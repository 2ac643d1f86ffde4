"""Export to C99: sources that need nothing, proved against the model before anything is written."""

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from hitchid._support import checks
from hitchid._support.files import canonical_json, check_folder, write_files, write_folder
from hitchid._support.jax_setup import installed_versions
from hitchid._support.precision import double_precision
from hitchid.control import ControllerFile
from hitchid.errors import InputError
from hitchid.export.c_templates import CTemplates, Precision, c_templates
from hitchid.export.constants import ModelConstants, constants_of
from hitchid.export.controller_code import controller_files
from hitchid.export.verification import (
    Compiler,
    Parity,
    ReferenceRun,
    Tolerance,
    displacement_range,
    find_compiler,
    reference_runs,
    tolerance_of,
    verify,
)
from hitchid.model import Hitch

MANIFEST = "manifest.json"
REPLAY = "replay.c"
SELF_TEST_SAMPLES = 300  # chosen: free run, measured displacements and changes of direction; 30 kB of source
SELF_TEST_MARGIN = 10  # on the tolerance of the proof: another compiler and C library round otherwise
SAMPLES = 3000  # of each reference run, 30 s at 100 Hz; chosen: all changes of direction occur
KEYWORDS = frozenset(
    [
        *("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum"),
        *("extern", "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return"),
        *("short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void"),
        *("volatile", "while"),
        # Of C++, so that the header may be included there, and the entry of a program.
        *("class", "new", "delete", "template", "this", "try", "catch", "throw", "public", "private"),
        *("protected", "virtual", "namespace", "using", "operator", "bool", "true", "false", "main"),
    ]
)
MAX_NAME = 24  # characters: the longest generated identifier stays within the 63 that C99 distinguishes
UNVERIFIED = "not verified: there is no C compiler (cc, gcc, clang, or pip install 'hitchid[fmu]')"


@dataclass(frozen=True)
class Export:
    """What was exported.

    Attributes:
        place: folder or file that was written.
        parity: differences from the model; None where nothing could be compiled.
        compiler: version of the compiler; empty without one.
        notices: what the user must know.
    """

    place: Path
    parity: Parity | None
    compiler: str
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class VerifiedSource:
    """Source of a model, and its proof.

    Attributes:
        model: that was exported, without compensators where they were not wanted.
        constants: its numbers.
        name: prefix of all names in the code.
        templates: with those numbers.
        files: header, source and replay program, name to text.
        runs: the reference runs, free and with measured displacements.
        parity: differences from the model; None where nothing could be compiled.
        compiler: that was used; None where there was none.
    """

    model: Hitch
    constants: ModelConstants
    name: str
    templates: CTemplates
    files: Mapping[str, str]
    runs: tuple[ReferenceRun, ReferenceRun]
    parity: Parity | None
    compiler: Compiler | None

    @property
    def travel_range(self) -> float:
        """Range of displacement in the tests, of which tolerances are shares."""
        return displacement_range(self.model, self.runs[0])

    @property
    def tolerance(self) -> Tolerance:
        """Largest differences that rounding explains."""
        precision = self.templates.context["precision"]
        return tolerance_of(precision, self.constants.error_steps, self.travel_range)

    @property
    def compiler_version(self) -> str:
        """Version of the compiler; empty without one."""
        return "" if self.compiler is None else self.compiler.version

    @property
    def notices(self) -> tuple[str, ...]:
        """What the user must know of the proof."""
        return () if self.parity else (UNVERIFIED,)


@checks.named_arguments
@double_precision
def to_c(
    model: Hitch,
    folder: str | Path,
    *,
    name: str = "hitch",
    precision: Precision = "mixed",
    compensators: bool = True,
    controller: ControllerFile | None = None,
    force: bool = False,
) -> Export:
    """Write a model as C99: header, source, self-test, a Python wrapper, manifest and README.

    The source is compiled and replays random commands; nothing is written where it differs from the model by
    more than rounding.

    Args:
        model: the model.
        folder: folder to write.
        name: prefix of all names in the code, a C identifier.
        precision: `mixed`: physics in double, networks in single precision; `double` or `single`: all of it.
        compensators: False for the physical model and its filter alone.
        controller: a position controller for the model, as `hitchid.control.load_controller` reads it, to be
            written beside it.
        force: replace an earlier export.

    Raises:
        InputError: the name is no C identifier, the controller is for another model, or the model has a
            structure that the export does not know.
        ParityError: the compiled code differs from the model.
        OutputError: the folder exists, or cannot be written.
    """
    out = checks.path(folder, "folder")
    # Before the proof, which takes seconds.
    check_folder(out, result_kind=MANIFEST, force=force)
    verified = verified_source(model, name, precision=precision, compensators=compensators)
    # The manifest states the proof, so that whoever gets the folder alone can see what was compared.
    stated, files = manifest(verified, "c", precision), c_files(verified)
    if controller is not None:
        code, difference = controller_files(controller, model, name, precision, verified.compiler)
        files |= code
        stated |= {"controller": {"current_difference": difference, "load": dict(controller.load)}}
    files[MANIFEST] = canonical_json(stated)
    write_folder(out, lambda target: write_files(target, files), result_kind=MANIFEST, force=force)
    return Export(out, verified.parity, verified.compiler_version, verified.notices)


def verified_source(
    model: Hitch, name: str, *, precision: Precision, compensators: bool, samples: int = SAMPLES
) -> VerifiedSource:
    """Return the source of a model that was compiled and compared with it; raises as `to_c`."""
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    check_name(name)
    checks.one_of(precision, ("mixed", "double", "single"), "precision")
    exported = exported_model(model, compensators=compensators)
    constants = constants_of(exported)
    runs = reference_runs(exported, samples)
    templates = c_templates(constants, name, precision)
    # The program that replays is part of the proof, and not of what is exported.
    files = {
        f"{name}.h": templates.render("model.h"),
        f"{name}.c": templates.render("model.c"),
        REPLAY: templates.render("replay.c"),
    }
    compiler = find_compiler()
    source = VerifiedSource(exported, constants, name, templates, files, runs, None, compiler)
    if compiler is None:
        return source
    with tempfile.TemporaryDirectory() as temporary:
        target = Path(temporary)
        write_files(target, {file: text.encode() for file, text in files.items()})
        parity = verify(
            compiler,
            [target / f"{name}.c", target / REPLAY],
            runs,
            source.travel_range,
            source.tolerance,
            compare_modes=precision != "single",  # a threshold may be passed a sample earlier
        )
    return replace(source, parity=parity)


def exported_model(model: Hitch, *, compensators: bool) -> Hitch:
    """Return what is exported of a model: all of it, or the physical model and its filter alone."""
    if compensators:
        return model
    channels = {
        direction: replace(channel, compensator=None, speed_compensator=None)
        for direction, channel in model.channels.items()
    }
    # Without bands, too: they are those of the whole model.
    return replace(model, channels=channels, uncertainty={})


def c_files(verified: VerifiedSource) -> dict[str, bytes]:
    """Return the files of an export to C, name to content."""
    name, templates = verified.name, verified.templates
    texts = {file: text for file, text in verified.files.items() if file != REPLAY}
    run = verified.runs[1]
    # A missing command is its last value, which is what the model takes: C has no NaN to write.
    rows, last = [], np.zeros(run.inputs.shape[1] - 1)
    for inputs, displacement in zip(run.inputs[:SELF_TEST_SAMPLES], run.displacement, strict=False):
        last = np.where(np.isfinite(inputs[:-1]), inputs[:-1], last)
        valid = bool(np.isfinite(inputs[-1]))
        rows.append((*last.tolist(), float(inputs[-1]) if valid else 0.0, float(valid), float(displacement)))
    tolerance = SELF_TEST_MARGIN * verified.tolerance.measured * verified.travel_range
    texts[f"{name}_selftest.c"] = templates.render(
        "selftest.c", rows=tuple(rows), start=run.start, load=run.load, tolerance=tolerance
    )
    texts[f"{name}.py"] = templates.render("library.py")
    version = verified.compiler_version
    texts["README.md"] = templates.render("README.md", parity=verified.parity, compiler=version)
    return {file: text.encode() for file, text in texts.items()}


def manifest(verified: VerifiedSource, target: str, precision: Precision) -> dict[str, object]:
    """Return what an export of C states about itself."""
    return statement(verified.constants, target, verified.parity, verified.compiler_version) | {
        "precision": precision,
        "memory_bytes": {
            "state": verified.templates.state_bytes,
            "saved_state": verified.templates.saved_bytes,
            "constants": verified.templates.constant_bytes(verified.files[f"{verified.name}.c"]),
        },
    }


def statement(
    constants: ModelConstants, target: str, parity: Parity | None, compiler: str
) -> dict[str, object]:
    """Return what any export states about itself; the compiler is what the proof was run by."""
    return {
        "target": target,
        "model": constants.digest,
        "versions": {"hitchid": installed_versions()["hitchid"]},
        "step_s": constants.step_s,
        "units": constants.units,
        "parity": None if parity is None else asdict(parity),
        "compiler": compiler or None,
        "license": "The generated code belongs to the user of hitchid, without any condition.",
    }


def check_name(name: str) -> str:
    """Return a name that is a C identifier.

    Raises:
        InputError: it is not, or is a keyword.
    """
    valid = name.isascii() and name.isidentifier() and not name.startswith("_")
    if not valid or name in KEYWORDS or len(name) > MAX_NAME:
        raise InputError(
            f"name: expected a C identifier of at most {MAX_NAME} letters, digits and _, no keyword, "
            f"got '{name}'"
        )
    return name
