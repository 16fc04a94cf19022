"""A Python function as an XLA custom call, so that compiled programs which call it can be kept on disk.

JAX keeps no program on disk that uses one of its own callbacks: they are objects of one process. A custom call is known
by its name alone, so that the next process finds the compiled program, and its own function behind the name.

The structures are those of XLA's foreign function interface, a stable binary interface: `xla/ffi/api/c_api.h`, which
comes with jaxlib.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

EXECUTE = 3  # the stage in which there are arguments
INTERNAL = 13  # the error code of what should not have happened
METADATA = 1  # the kind of extension by which XLA asks for the version of the interface


class _Buffer(ctypes.Structure):
    _fields_ = (
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("dtype", ctypes.c_int),
        ("data", ctypes.c_void_p),
        ("rank", ctypes.c_int64),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
    )


class _Buffers(ctypes.Structure):
    """XLA_FFI_Args and XLA_FFI_Rets."""

    _fields_ = (
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("count", ctypes.c_int64),
        ("kinds", ctypes.c_void_p),
        ("buffers", ctypes.POINTER(ctypes.POINTER(_Buffer))),
    )


class _Version(ctypes.Structure):
    _fields_ = (
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("major", ctypes.c_int),
        ("minor", ctypes.c_int),
    )


class _Metadata(ctypes.Structure):
    _fields_ = (("size", ctypes.c_size_t), ("version", _Version))


class _Extension(ctypes.Structure):
    _fields_ = (
        ("size", ctypes.c_size_t),
        ("kind", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("metadata", ctypes.POINTER(_Metadata)),
    )


class _Error(ctypes.Structure):
    _fields_ = (
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("message", ctypes.c_char_p),
        ("code", ctypes.c_int),
    )


class _Api(ctypes.Structure):
    _fields_ = (
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("version", _Version),
        ("internal", ctypes.c_void_p),
        ("make_error", ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_Error))),
    )


class _Frame(ctypes.Structure):
    _fields_ = (
        ("size", ctypes.c_size_t),
        ("extension", ctypes.POINTER(_Extension)),
        ("api", ctypes.POINTER(_Api)),
        ("context", ctypes.c_void_p),
        ("stage", ctypes.c_int),
        ("arguments", _Buffers),
        ("results", _Buffers),
    )


_Handler = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_Frame))
_registered: list[Any] = []
"""XLA keeps pointers to these for ever."""


def register(name: str, function: Callable[[Sequence[np.ndarray], Sequence[np.ndarray]], None]) -> None:
    """Let XLA on CPUs call `function(results, arguments)` by `name`: float32 arrays in XLA's own memory.

    It must not compute with JAX, which may be waiting for it.
    """

    def handle(frame: Any) -> Any:
        call = frame.contents
        if call.extension and call.extension.contents.kind == METADATA:
            version = call.extension.contents.metadata.contents.version
            version.major, version.minor = 0, 1
            return None
        if call.stage != EXECUTE:
            return None
        try:
            function(_arrays(call.results), _arrays(call.arguments))
        except BaseException as error:
            text = f"{type(error).__name__}: {error}".encode()
            return call.api.contents.make_error(_Error(ctypes.sizeof(_Error), None, text, INTERNAL))
        return None

    handler = _Handler(handle)
    _registered.append(handler)
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")


def _arrays(buffers: _Buffers) -> list[np.ndarray]:
    found = []
    for i in range(buffers.count):
        buffer = buffers.buffers[i].contents
        shape = buffer.shape[: buffer.rank]
        memory: Any = (ctypes.c_float * math.prod(shape)).from_address(buffer.data)
        found.append(np.frombuffer(memory, np.float32).reshape(shape))
    return found
