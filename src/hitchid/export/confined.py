"""Runs a program that may do no more than compute: `python -I -S confined.py FOLDERS PROGRAM ARGUMENTS…`.

A program of its own, since what a process gives up it gives up for good; it then becomes the other. On Linux
the kernel (Landlock) leaves it the first of the folders, which the separator of paths parts, the others and
the system's libraries to read; elsewhere it has limits and an empty environment alone.
"""

import ctypes
import os
import resource
import sys
from contextlib import suppress

# Memory, bytes; computing time, s; largest file, bytes; open files; core dump, bytes; further processes. A
# replay takes 10 MiB, a second, 0.1 MiB, five files.
LIMITS = {
    "RLIMIT_AS": 1 << 30,
    "RLIMIT_CPU": 60,
    "RLIMIT_FSIZE": 1 << 28,
    "RLIMIT_NOFILE": 32,
    "RLIMIT_CORE": 0,
    "RLIMIT_NPROC": 0,
}
LIBRARIES = ("/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/nix/store", "/gnu/store")
LINKER_FILES = ("/etc/ld.so.cache", "/etc/ld.so.preload")
# Of linux/landlock.h: rights on files by the version that has them, and the numbers of the calls.
EXECUTE, READ_FILE, READ_FOLDER = 1 << 0, 1 << 2, 1 << 3
FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}  # version to the number of rights, each one bit
TCP, SCOPES = 0b11, 0b11  # to bind and to connect, from version 4; sockets and signals, from version 6
CREATE, ADD, RESTRICT = 444, 445, 446
BENEATH = 1  # kind of a rule: all below a folder
NO_NEW_PRIVILEGES = 38  # of prctl


class _Ruleset(ctypes.Structure):
    _fields_ = (("files", ctypes.c_uint64), ("net", ctypes.c_uint64), ("scoped", ctypes.c_uint64))


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("rights", ctypes.c_uint64), ("folder", ctypes.c_int32))


def limit(but: str = "") -> None:
    """Bound what the process may take, but for one limit, as far as its system has a limit of the kind."""
    for name, bound in LIMITS.items():
        if name == but:
            continue
        with suppress(AttributeError, OSError, ValueError):
            kind = getattr(resource, name)
            _, hard = resource.getrlimit(kind)
            most = bound if hard == resource.RLIM_INFINITY else min(bound, hard)
            resource.setrlimit(kind, (most, most))


def confine(folder: str, *readable: str) -> None:
    """Give up connections, and all files but a folder, readable ones and libraries, where the kernel can."""
    if sys.platform != "linux":
        return
    kernel = ctypes.CDLL(None, use_errno=True)
    version = kernel.syscall(CREATE, None, ctypes.c_size_t(0), ctypes.c_uint32(1))
    if version < 1:
        return
    all_rights = (1 << max(count for since, count in FILE_RIGHTS.items() if since <= version)) - 1
    rules = _Ruleset(all_rights, TCP if version >= 4 else 0, SCOPES if version >= 6 else 0)
    size = 8 * (1 + (version >= 4) + (version >= 6))
    handle = kernel.syscall(CREATE, ctypes.byref(rules), ctypes.c_size_t(size), ctypes.c_uint32(0))
    libraries = EXECUTE | READ_FILE | READ_FOLDER
    granted = {
        folder: all_rights,
        **dict.fromkeys((*LIBRARIES, *readable), libraries),
        **dict.fromkeys(LINKER_FILES, READ_FILE),
    }
    for path, rights in granted.items():
        if os.path.exists(path):  # no system has all of them
            descriptor = os.open(path, os.O_PATH)
            if os.path.isfile(path):
                rights &= ~READ_FOLDER  # which no file has
            rule = _Beneath(rights, descriptor)
            if kernel.syscall(ADD, handle, BENEATH, ctypes.byref(rule), ctypes.c_uint32(0)):
                raise OSError(ctypes.get_errno(), "landlock_add_rule", path)
            os.close(descriptor)
    # The kernel asks for the first: a program with more rights must not be started with less to see.
    if kernel.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0) or kernel.syscall(RESTRICT, handle, ctypes.c_uint32(0)):
        raise OSError(ctypes.get_errno(), "landlock_restrict_self")
    os.close(handle)


if __name__ == "__main__":
    own, *readable = sys.argv[1].split(os.pathsep)
    # A program that reads more is an interpreter, which has threads; they count as processes.
    limit(but="RLIMIT_NPROC" if readable else "")
    confine(own, *readable)
    os.execve(sys.argv[2], sys.argv[2:], {})  # noqa: S606 - it is what was to be confined
