"""Export to FMI 2.0 and 3.0: the proved C code behind a thin adapter, as sources and as binaries."""

import io
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hitchid._support import checks
from hitchid._support.files import canonical_json, check_file, digest, write_bytes, write_files
from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.export.c99 import Export, VerifiedSource, manifest, verified_source
from hitchid.export.c_templates import Precision
from hitchid.export.model_description import (
    Variable,
    Version,
    build_description,
    fmu_variables,
    model_description,
)
from hitchid.export.verification import zig_compiler
from hitchid.model import Hitch

EPOCH = (1980, 1, 1, 0, 0, 0)  # date of all files in the archive: equal content gives equal bytes
# A library with no names but those of the interface, and nothing of this machine.
LIBRARY = ("-shared", "-fPIC", "-fvisibility=hidden", "-g0", "-s")


class Platform(NamedTuple):
    """A platform that an FMU may hold a binary for.

    Attributes:
        target: of ziglang's compiler.
        suffix: of a shared library.
        folders: in the archive, of FMI 2.0 and 3.0.
    """

    target: str
    suffix: str
    folders: dict[Version, str]


PLATFORMS = {
    "linux64": Platform("x86_64-linux-gnu.2.17", ".so", {"fmi2": "linux64", "fmi3": "x86_64-linux"}),
    "win64": Platform("x86_64-windows-gnu", ".dll", {"fmi2": "win64", "fmi3": "x86_64-windows"}),
    "darwin64": Platform("x86_64-macos.11.0", ".dylib", {"fmi2": "darwin64", "fmi3": "x86_64-darwin"}),
    "aarch64-linux": Platform(
        "aarch64-linux-gnu.2.17", ".so", {"fmi2": "aarch64-linux", "fmi3": "aarch64-linux"}
    ),
    "aarch64-darwin": Platform(
        "aarch64-macos.11.0", ".dylib", {"fmi2": "aarch64-darwin", "fmi3": "aarch64-darwin"}
    ),
}


@checks.named_arguments
@double_precision
def to_fmu(
    model: Hitch,
    path: str | Path,
    *,
    version: Version = "fmi2",
    name: str = "hitch",
    precision: Precision = "mixed",
    compensators: bool = True,
    platforms: Sequence[str] | None = None,
    force: bool = False,
) -> Export:
    """Write a model as a Functional Mock-up Unit for Co-Simulation and Model Exchange, without Python inside.

    The C code in it replays random commands and must repeat the model, as in `to_c`. Binaries are made by the
    package ziglang for every platform, else by the C compiler for this one; the sources are always inside.

    Args:
        model: the model.
        path: file to write, `NAME.fmu`.
        version: `fmi2` or `fmi3`.
        name: model identifier, a C identifier.
        precision, compensators: as in `to_c`.
        platforms: of linux64, win64, darwin64, aarch64-linux, aarch64-darwin; by default all with
            ziglang, otherwise this machine's.
        force: replace an existing file.

    Raises:
        InputError: as `to_c`; or a platform is not known, or cannot be compiled for.
        ParityError: the compiled code differs from the model.
        OutputError: the file exists, or cannot be written.
    """
    out = checks.path(path, "path")
    checks.one_of(version, ("fmi2", "fmi3"), "version")
    chosen = None if platforms is None else [checks.one_of(own, PLATFORMS, "platform") for own in platforms]
    check_file(out, force=force)
    verified = verified_source(model, name, precision=precision, compensators=compensators)
    variables, sources = fmu_sources(verified, version)
    binaries, notices = _binaries(verified, version, sources, chosen)
    compiler = verified.compiler_version
    page = verified.templates.render(
        "documentation.html", variables=variables, parity=verified.parity, compiler=compiler
    )
    # The sources always: a tool may build for a platform that has no binary here.
    content = {**sources, **binaries, "documentation/index.html": page.encode()}
    content["resources/manifest.json"] = canonical_json(
        {**manifest(verified, version, precision), "platforms": sorted(binaries)}
    )
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path_in_archive in sorted(content, key=lambda key: (key != "modelDescription.xml", key)):
            entry = zipfile.ZipInfo(path_in_archive, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            entry.create_system = 3  # the same on all platforms
            file.writestr(entry, content[path_in_archive])
    write_bytes(out, archive.getvalue(), force=force)
    return Export(out, verified.parity, compiler, (*verified.notices, *notices))


def fmu_sources(verified: VerifiedSource, version: Version) -> tuple[tuple[Variable, ...], dict[str, bytes]]:
    """Return the variables of an FMU, and its description and sources, path in the archive to content.

    Description and code hold a token of the model and the code.
    """
    name, templates = verified.name, verified.templates
    start = verified.runs[0].start
    parameters = templates.context["parameters"]
    variables = tuple(fmu_variables(verified.constants, parameters, start, with_time=version == "fmi3"))
    adapter = f"{name}_{version}.c"
    code = {file: verified.files[file].encode() for file in (f"{name}.h", f"{name}.c")}
    # The code holds the token, which is a digest of the code: that of the code without one.
    text = templates.render(f"{version}.c", variables=variables, token="", **_state_header(b"", variables))
    identity = digest(b"\0".join([text.encode(), *code.values(), verified.constants.digest.encode()]))
    token = f"{{{identity[:8]}-{identity[8:12]}-{identity[12:16]}-{identity[16:20]}-{identity[20:32]}}}"
    header = _state_header(bytes.fromhex(identity[:24]), variables)
    code[adapter] = templates.render(f"{version}.c", variables=variables, token=token, **header).encode()
    described = (
        f"Displacement of {templates.context['directions']}, sampled every {verified.constants.step_s} s; "
        f"hitchid model {verified.constants.digest[:12] or 'not saved'}"
    )
    compiled, step_s = (f"{name}.c", adapter), verified.constants.step_s
    files = {f"sources/{file}": text for file, text in code.items()}
    files["modelDescription.xml"] = model_description(
        version, name, token, variables, step_s, compiled, described
    )
    if version == "fmi3":
        files["sources/buildDescription.xml"] = build_description(name, compiled)
    return variables, files


def _state_header(identity: bytes, variables: Sequence[Variable]) -> dict[str, object]:
    """Return the first bytes of a saved state, and the symbols of the covariates."""
    # Part of the token: a state of another FMU, or of another export of this model, is refused.
    magic = b"HFMU" + identity.ljust(12, b"\0")
    loads = [variable.symbol for variable in variables if variable.symbol.startswith("LOAD_")]
    return {"state_magic": list(magic), "load_symbols": loads}


def _binaries(
    verified: VerifiedSource,
    version: Version,
    sources: Mapping[str, bytes],
    platforms: Sequence[str] | None,
) -> tuple[dict[str, bytes], list[str]]:
    """Return path in the archive to shared library, and notices."""
    cross = zig_compiler()
    here = _this_platform()
    if platforms is None:
        platforms = list(PLATFORMS) if cross else [here] if verified.compiler and here else []
    # A compiler of the system compiles for its own platform only.
    others = [name for name in platforms if name != here]
    if others and cross is None:
        raise InputError(
            f"platform {others[0]}: this machine compiles for {here or 'no platform'} only; "
            "run: pip install 'hitchid[fmu]'"
        )
    if not platforms:
        return {}, ["no binary: there is no C compiler; the FMU holds its sources only"]
    binaries = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_files(folder, {path.rpartition("/")[2]: content for path, content in sources.items()})
        paths = [folder / f"{verified.name}.c", folder / f"{verified.name}_{version}.c"]
        for target in map(PLATFORMS.__getitem__, platforms):
            out = folder / f"{verified.name}{target.suffix}"
            if cross is not None:
                cross.compile(paths, out, "-target", target.target, *LIBRARY)
            elif verified.compiler is not None:
                verified.compiler.compile(paths, out, *LIBRARY)
            binaries[f"binaries/{target.folders[version]}/{out.name}"] = out.read_bytes()
    return binaries, []


def _this_platform() -> str | None:
    """Return the name of the platform that this process runs on; None for one that is not known."""
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    system = "windows" if sys.platform == "win32" else sys.platform
    folders = {target.folders["fmi3"]: name for name, target in PLATFORMS.items()}
    return folders.get(f"{machine}-{system}")
