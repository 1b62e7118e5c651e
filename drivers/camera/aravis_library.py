"""The functions of Aravis 0.8 that the driver calls, by ctypes: its Python binding is tied to the system's Python."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint64, c_void_p
from typing import Any

from drivers.camera.backend import NodeFailed, NodeRefused

_GOBJECT = "libgobject-2.0.so.0"
# ArvDeviceError: wrong feature, feature not found, invalid parameter.
_REFUSALS = (0, 1, 7)


class _Error(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


# Name: (result, arguments); where the last is True, a GError follows them.
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...], bool]] = {
    "arv_disable_interface": (None, (c_char_p,), False),
    "arv_open_device": (c_void_p, (c_char_p,), True),
    "arv_gv_device_is_controller": (c_bool, (c_void_p,), False),
    "arv_device_set_range_check_policy": (None, (c_void_p, c_int), False),
    "arv_device_set_access_check_policy": (None, (c_void_p, c_int), False),
    "arv_device_get_genicam_xml": (c_void_p, (c_void_p, POINTER(c_size_t)), False),
    "arv_device_get_feature": (c_void_p, (c_void_p, c_char_p), False),
    "arv_device_get_feature_access_mode": (c_int, (c_void_p, c_char_p), False),
    "arv_device_is_feature_available": (c_bool, (c_void_p, c_char_p), True),
    "arv_device_get_integer_feature_value": (c_int64, (c_void_p, c_char_p), True),
    "arv_device_get_float_feature_value": (c_double, (c_void_p, c_char_p), True),
    "arv_device_get_string_feature_value": (c_char_p, (c_void_p, c_char_p), True),
    "arv_device_get_boolean_feature_value": (c_bool, (c_void_p, c_char_p), True),
    "arv_device_set_integer_feature_value": (None, (c_void_p, c_char_p, c_int64), True),
    "arv_device_set_float_feature_value": (None, (c_void_p, c_char_p, c_double), True),
    "arv_device_set_string_feature_value": (None, (c_void_p, c_char_p, c_char_p), True),
    "arv_device_set_boolean_feature_value": (None, (c_void_p, c_char_p, c_bool), True),
    "arv_device_execute_command": (None, (c_void_p, c_char_p), True),
    "arv_device_get_integer_feature_bounds": (
        None, (c_void_p, c_char_p, POINTER(c_int64), POINTER(c_int64)), True,
    ),
    "arv_device_get_float_feature_bounds": (
        None, (c_void_p, c_char_p, POINTER(c_double), POINTER(c_double)), True,
    ),
    "arv_device_get_integer_feature_increment": (c_int64, (c_void_p, c_char_p), True),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        c_void_p, (c_void_p, c_char_p, POINTER(c_uint)), True,
    ),
    "arv_device_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p), True),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p), False),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64), False),
    "arv_stream_get_statistics": (None, (c_void_p, POINTER(c_uint64), POINTER(c_uint64), POINTER(c_uint64)), False),
    "arv_buffer_new": (c_void_p, (c_size_t, c_void_p), False),
    "arv_buffer_get_status": (c_int, (c_void_p,), False),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t)), False),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,), False),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,), False),
    "arv_buffer_get_image_width": (c_int, (c_void_p,), False),
    "arv_buffer_get_image_height": (c_int, (c_void_p,), False),
    "arv_buffer_get_image_pixel_format": (ctypes.c_uint32, (c_void_p,), False),
    "arv_buffer_get_image_padding": (None, (c_void_p, POINTER(c_int), POINTER(c_int)), False),
    "arv_device_error_quark": (ctypes.c_uint32, (), False),
    **{
        f"arv_gc_{kind}_get_type": (c_size_t, (), False)
        for kind in ("enumeration", "boolean", "command", "string", "float", "integer")
    },
}  # fmt: skip


class AravisLibrary:
    """Aravis; `library.arv_...(...)` raises NodeFailed or NodeRefused where the function tells an error.

    Parameters
    ----------
    name
        File name of the library.

    Raises
    ------
    OSError
        It cannot be loaded.
    AttributeError
        It lacks a function: another version.
    """

    def __init__(self, name: str) -> None:
        library = ctypes.CDLL(name)
        # Loaded with it, but not from it: glib's names are looked up through gobject.
        self._gobject = ctypes.CDLL(_GOBJECT)
        self._gobject.g_error_free.argtypes = (c_void_p,)
        self._gobject.g_free.argtypes = (c_void_p,)
        self._gobject.g_object_unref.argtypes = (c_void_p,)
        self._gobject.g_type_check_instance_is_a.argtypes = (c_void_p, c_size_t)
        for function, (result, arguments, fails) in _FUNCTIONS.items():
            found = getattr(library, function)
            found.restype = result
            found.argtypes = (*arguments, POINTER(POINTER(_Error))) if fails else arguments
            setattr(self, function, self._checked(found) if fails else found)
        self._device_errors = library.arv_device_error_quark()

    def __getattr__(self, function: str) -> Callable[..., Any]:
        raise AttributeError(function)

    def unref(self, thing: int) -> None:
        """Let an object go."""
        self._gobject.g_object_unref(thing)

    def is_a(self, thing: int, kind: int) -> bool:
        """Whether an object is of a type."""
        return bool(self._gobject.g_type_check_instance_is_a(thing, kind))

    def set_number(self, thing: int, name: str, value: int) -> None:
        """Set a property that is an enumeration or a whole number."""
        self._gobject.g_object_set(c_void_p(thing), name.encode(), c_int(value), None)

    @contextmanager
    def strings(self, address: int, count: int) -> Iterator[list[str]]:
        """Read an array of strings that the library owns; the array itself is freed."""
        try:
            yield [(text or b"").decode() for text in (c_char_p * count).from_address(address)] if count else []
        finally:
            self._gobject.g_free(address)

    def _checked(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            error = POINTER(_Error)()
            result = function(*arguments, byref(error))
            if not error:
                return result
            domain, code = error.contents.domain, error.contents.code
            text = (error.contents.message or b"").decode(errors="replace")
            self._gobject.g_error_free(ctypes.cast(error, c_void_p))
            if domain != self._device_errors or code in _REFUSALS:
                raise NodeRefused(text)
            raise NodeFailed(text)

        return call
