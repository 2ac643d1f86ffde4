"""Writers of MATLAB files as MATLAB writes them: structs, arrays of structs, cells, objects that it hides."""

import struct

import h5py
import numpy as np
from scipy.io import savemat

MCOS = np.array([[0xDD000000], [2], [1], [1], [1], [1]], np.uint32)  # a reference to the first object


class Cell(list):
    """A cell array; a plain list is an array of structs."""


class Object:
    """An object of a class, of which a file shows the name of the class alone."""

    def __init__(self, kind):
        self.kind = kind


def mat73(path, variables):
    """Write variables as MATLAB 7.3 does: HDF5 behind 512 bytes, matrices turned, structs as groups."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            put73(file, file, name, value)
    with path.open("r+b") as stream:
        stream.write(
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + struct.pack("<H2s", 0x0200, b"IM")
        )


def put73(file, group, name, value):
    if isinstance(value, dict):
        inside = group.create_group(name)
        inside.attrs["MATLAB_class"] = np.bytes_("struct")
        for field, inner in value.items():
            put73(file, inside, field, inner)
    elif isinstance(value, Object):
        dataset = group.create_dataset(name, data=MCOS.T)
        dataset.attrs["MATLAB_class"], dataset.attrs["MATLAB_object_decode"] = np.bytes_(value.kind), 3
    elif isinstance(value, Cell):
        kept = file.require_group("#refs#")
        names = [f"{len(kept)}_{k}" for k in range(len(value))]
        for key, entry in zip(names, value, strict=True):
            put73(file, kept, key, entry)
        references = np.array([[kept[key].ref] for key in names], dtype=h5py.ref_dtype)
        group.create_dataset(name, data=references, dtype=h5py.ref_dtype)
        group[name].attrs["MATLAB_class"] = np.bytes_("cell")
    elif isinstance(value, list):
        inside, kept = group.create_group(name), file.require_group("#refs#")
        inside.attrs["MATLAB_class"] = np.bytes_("struct")
        for field in value[0]:
            names = [f"{len(kept)}_{k}" for k in range(len(value))]
            for key, one in zip(names, value, strict=True):
                put73(file, kept, key, one[field])
            references = np.array([[kept[key].ref] for key in names], dtype=h5py.ref_dtype)
            inside.create_dataset(field, data=references, dtype=h5py.ref_dtype)
    elif isinstance(value, str):
        dataset = group.create_dataset(name, data=np.array([[ord(letter)] for letter in value], np.uint16))
        dataset.attrs["MATLAB_class"] = np.bytes_("char")
    else:
        matrix = np.atleast_2d(value)
        dataset = group.create_dataset(name, data=matrix.astype(np.uint8) if matrix.dtype == bool else matrix)
        kinds = {"float64": "double", "float32": "single", "bool": "logical"}
        dataset.attrs["MATLAB_class"] = np.bytes_(kinds.get(str(matrix.dtype), str(matrix.dtype)))


def mat5(path, variables):
    """Write variables as MATLAB 5 does: a list is an array of structs."""
    plain = {name: value for name, value in variables.items() if not isinstance(value, Object)}
    savemat(path, {name: scipys(value) for name, value in plain.items()}, long_field_names=True)
    with path.open("ab") as stream:
        for name, value in variables.items():
            if isinstance(value, Object):
                stream.write(opaque(name, value.kind))


def scipys(value):
    if isinstance(value, dict):
        return {field: scipys(inner) for field, inner in value.items()}
    if isinstance(value, Cell):
        cells = np.empty((1, len(value)), dtype=object)
        for k, entry in enumerate(value):
            cells[0, k] = scipys(entry)
        return cells
    if not isinstance(value, list):
        return value
    made = np.zeros((1, len(value)), dtype=[(field, object) for field in value[0]])
    for k, one in enumerate(value):
        for field, inner in one.items():
            made[field][0, k] = scipys(inner)
    return made


def element(kind, data):
    """Return an element of a file of version 5: tag, data, padding."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def opaque(name, kind):
    """Return a variable of version 5 that holds an object."""
    reference = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", *MCOS.shape))
    reference += element(1, b"") + element(6, MCOS.tobytes())
    words = [element(1, text.encode()) for text in (name, "MCOS", kind)]
    return element(14, element(6, struct.pack("<II", 17, 0)) + b"".join(words) + element(14, reference))
