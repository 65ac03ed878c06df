"""Takes a message together with the identity (GID) of its publisher.

rclpy provides the GID since 9.1.1 (Kilted). Older versions, as in Jazzy, drop it; there this module calls rcl directly.
The structures are those of rcutils/allocator.h, rcutils/types/uint8_array.h and rmw/types.h, the same in both.
"""

from __future__ import annotations

import ctypes
from typing import Any

import rclpy.subscription
from rclpy.impl.implementation_singleton import rclpy_implementation

GIVES_PUBLISHER = "publisher_gid" in getattr(getattr(rclpy.subscription, "MessageInfo", None), "__annotations__", ())
OK, NOTHING_THERE = 0, 401  # RCL_RET_OK, RCL_RET_SUBSCRIPTION_TAKE_FAILED
UNCOUNTED = 2**64 - 1  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED


class _Allocator(ctypes.Structure):
    _fields_ = tuple((f"_{i}", ctypes.c_void_p) for i in range(5))


class _Serialized(ctypes.Structure):
    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Information(ctypes.Structure):
    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("implementation", ctypes.c_char_p),
        ("publisher", ctypes.c_uint8 * 16),
        ("from_intra_process", ctypes.c_bool),
    )


class _Rcl:
    """Takes serialized messages from rcl into a reused buffer."""

    def __init__(self) -> None:
        allocator = ctypes.CDLL("librcutils.so").rcutils_get_default_allocator
        allocator.restype = _Allocator
        self._take = ctypes.CDLL("librcl.so").rcl_take_serialized_message
        self._take.argtypes = [ctypes.c_void_p] * 4
        self._message, self._information = _Serialized(allocator=allocator()), _Information()
        self._places = ctypes.addressof(self._message), ctypes.addressof(self._information)

    def take(self, subscription: Any) -> tuple[bytes, dict[str, Any]] | None:
        status = self._take(subscription.handle.pointer, *self._places, None)
        if status == NOTHING_THERE:
            return None
        if status != OK:
            raise rclpy_implementation.RCLError(f"{subscription.topic_name}: rcl_take_serialized_message: {status}")
        message, information = self._message, self._information
        sequence = information.publication_sequence_number
        return ctypes.string_at(message.buffer, message.length), {
            "source_timestamp": information.source_timestamp,
            "publication_sequence_number": None if sequence == UNCOUNTED else sequence,
            "publisher_gid": {"data": bytes(information.publisher)},
        }


_rcl = None if GIVES_PUBLISHER else _Rcl()


def take(subscription: Any) -> tuple[Any, Any] | None:
    """Take a message of a subscription with its message information; None if there is no message.

    The information is rclpy's `MessageInfo`: at least source_timestamp, publication_sequence_number, publisher_gid.
    """
    if _rcl is not None and subscription.raw:
        return _rcl.take(subscription)
    message: tuple[Any, Any] | None = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return message
