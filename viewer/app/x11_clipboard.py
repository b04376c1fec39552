"""Owns the clipboard of an X11 display for one picture. A process of its own: a selection is what its owner answers.

Reads a PNG file from standard input, as an 8-byte length (little endian) and that many bytes, and prints a line once it owns
the clipboard. It answers other programs (ICCCM, section 2: TARGETS and image/png) until another program takes the clipboard or
standard input ends with the program that started it. Talks to libX11 through ctypes.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import select
import sys
from ctypes import POINTER, Structure, Union, byref, c_char_p, c_int, c_long, c_ulong, c_void_p

SELECTION_CLEAR, SELECTION_REQUEST, SELECTION_NOTIFY = 29, 30, 31
REPLACE, NOW, XA_ATOM = 0, 0, 4
HEAD = 1024  # bytes of a request besides its property
OWNED, TOO_LARGE, NO_DISPLAY = "owned", "too large", "no display"

_Header = [("type", c_int), ("serial", c_ulong), ("send_event", c_int), ("display", c_void_p)]


class _Request(Structure):
    _fields_ = (*_Header, *((n, c_ulong) for n in ("owner", "requestor", "selection", "target", "property", "time")))


class _Notify(Structure):
    _fields_ = (*_Header, *((n, c_ulong) for n in ("requestor", "selection", "target", "property", "time")))


class _Event(Union):
    _fields_ = (("type", c_int), ("request", _Request), ("notify", _Notify), ("room", c_long * 24))


class Owner:
    """The clipboard of the display that DISPLAY names, with `picture` (a PNG file) in it. OSError where there is no display."""

    def __init__(self, picture: bytes) -> None:
        self.x11, self.picture = _libx11(), picture
        self.display = self.x11.XOpenDisplay(None)
        if not self.display:
            raise OSError(NO_DISPLAY)
        # A property is set in one request; larger pictures would need the protocol for pieces (INCR).
        if len(picture) > 4 * self.x11.XExtendedMaxRequestSize(self.display) - HEAD:
            raise OverflowError(TOO_LARGE)
        root = self.x11.XDefaultRootWindow(self.display)
        self.window = self.x11.XCreateSimpleWindow(self.display, root, 0, 0, 1, 1, 0, 0, 0)
        self.x11.XSetErrorHandler(_IGNORE)  # a program that asks may be gone before it is answered
        self.x11.XSetSelectionOwner(self.display, self._atom("CLIPBOARD"), self.window, NOW)
        self.x11.XFlush(self.display)

    def serve(self, until: int) -> None:
        """Answers until the clipboard is another's, or the file descriptor `until` has ended."""
        connection, event = self.x11.XConnectionNumber(self.display), _Event()
        while True:
            while self.x11.XPending(self.display):
                self.x11.XNextEvent(self.display, byref(event))
                if event.type == SELECTION_CLEAR:
                    return
                if event.type == SELECTION_REQUEST:
                    self._answer(event.request)
            ready, _, _ = select.select([connection, until], [], [])
            if until in ready and not os.read(until, 4096):
                return

    def _answer(self, request: _Request) -> None:
        answer, place = _Event(), request.property or request.target
        if request.target == self._atom("TARGETS"):
            atoms = (c_ulong * 2)(self._atom("TARGETS"), self._atom("image/png"))
            self._put(request.requestor, place, XA_ATOM, 32, bytes(atoms), 2)
        elif request.target == self._atom("image/png"):
            self._put(request.requestor, place, request.target, 8, self.picture, len(self.picture))
        else:
            place = 0  # refused
        answer.notify.type, answer.notify.requestor, answer.notify.time = (
            SELECTION_NOTIFY,
            request.requestor,
            request.time,
        )
        answer.notify.selection, answer.notify.target = request.selection, request.target
        answer.notify.property = place
        self.x11.XSendEvent(self.display, request.requestor, 0, 0, byref(answer))
        self.x11.XFlush(self.display)

    def _put(self, window: int, place: int, kind: int, bits: int, data: bytes, count: int) -> None:
        self.x11.XChangeProperty(self.display, window, place, kind, bits, REPLACE, data, count)

    def _atom(self, name: str) -> int:
        return self.x11.XInternAtom(self.display, name.encode(), 0)


@ctypes.CFUNCTYPE(c_int, c_void_p, c_void_p)
def _IGNORE(_display, _error):
    return 0


def _libx11() -> ctypes.CDLL:
    """libX11 with the types of what is used of it. OSError where there is none."""
    x11 = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
    x11.XOpenDisplay.argtypes, x11.XOpenDisplay.restype = [c_char_p], c_void_p
    x11.XInternAtom.argtypes, x11.XInternAtom.restype = [c_void_p, c_char_p, c_int], c_ulong
    x11.XDefaultRootWindow.argtypes, x11.XDefaultRootWindow.restype = [c_void_p], c_ulong
    x11.XCreateSimpleWindow.argtypes = [c_void_p, c_ulong, *[c_int] * 4, c_int, c_ulong, c_ulong]
    x11.XCreateSimpleWindow.restype = c_ulong
    x11.XSetSelectionOwner.argtypes = [c_void_p, c_ulong, c_ulong, c_ulong]
    x11.XSendEvent.argtypes = [c_void_p, c_ulong, c_int, c_long, POINTER(_Event)]
    x11.XChangeProperty.argtypes = [c_void_p, c_ulong, c_ulong, c_ulong, c_int, c_int, c_char_p, c_int]
    x11.XNextEvent.argtypes = [c_void_p, POINTER(_Event)]
    x11.XExtendedMaxRequestSize.argtypes, x11.XExtendedMaxRequestSize.restype = [c_void_p], c_long
    x11.XConnectionNumber.argtypes = x11.XPending.argtypes = x11.XFlush.argtypes = [c_void_p]
    return x11


def _read_exactly(count: int) -> bytes:
    data = bytearray()
    while len(data) < count and (part := os.read(0, count - len(data))):
        data += part
    return bytes(data)


def main() -> int:
    """Status 0; says in one line how it went before it serves."""
    picture = _read_exactly(int.from_bytes(_read_exactly(8), "little"))
    try:
        owner = Owner(picture)
    except (OSError, OverflowError) as error:
        print(error, flush=True)
        return 0
    print(OWNED, flush=True)
    owner.serve(until=0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
