"""Another X client, as a file manager or a window manager is one: drops files on a window, or asks it to close.

python x11_client.py drop WINDOW FILE...: the whole of XDND's protocol, version 5, as its source (freedesktop.org).
python x11_client.py paste WINDOW FILE: saves the picture on the clipboard.
python x11_client.py close WINDOW: WM_DELETE_WINDOW, which is what the cross in a window's frame sends.
Talks to libX11 through ctypes but for the clipboard; ends with status 0 once the window says that it is done.
"""

import ctypes
import ctypes.util
import sys
import time
from ctypes import POINTER, Structure, Union, byref, c_char_p, c_int, c_long, c_ulong, c_void_p
from pathlib import Path

import copykitten
from PIL import Image

CLIENT_MESSAGE, SELECTION_NOTIFY, SELECTION_REQUEST = 33, 31, 30
ANY_TIME, PROP_MODE_REPLACE, XDND_VERSION, PATIENCE_S = 0, 0, 5, 15.0

Header = [("type", c_int), ("serial", c_ulong), ("send_event", c_int), ("display", c_void_p)]


class ClientMessage(Structure):
    _fields_ = (*Header, ("window", c_ulong), ("message_type", c_ulong), ("format", c_int), ("data", c_long * 5))


class SelectionRequest(Structure):
    names = "owner", "requestor", "selection", "target", "property", "time"
    _fields_ = (*Header, *((name, c_ulong) for name in names))


class SelectionNotify(Structure):
    _fields_ = (*Header, *((name, c_ulong) for name in ["requestor", "selection", "target", "property", "time"]))


class Event(Union):
    _fields_ = (
        ("type", c_int),
        ("client", ClientMessage),
        ("request", SelectionRequest),
        ("notify", SelectionNotify),
        ("room", c_long * 24),
    )


def libx11() -> ctypes.CDLL:
    """libX11 with the types of what is used of it."""
    x11 = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
    x11.XOpenDisplay.argtypes, x11.XOpenDisplay.restype = [c_char_p], c_void_p
    x11.XInternAtom.argtypes, x11.XInternAtom.restype = [c_void_p, c_char_p, c_int], c_ulong
    x11.XDefaultRootWindow.argtypes, x11.XDefaultRootWindow.restype = [c_void_p], c_ulong
    x11.XCreateSimpleWindow.argtypes = [c_void_p, c_ulong, *[c_int] * 4, c_int, c_ulong, c_ulong]
    x11.XCreateSimpleWindow.restype = c_ulong
    x11.XSetSelectionOwner.argtypes = [c_void_p, c_ulong, c_ulong, c_ulong]
    x11.XSendEvent.argtypes = [c_void_p, c_ulong, c_int, c_long, POINTER(Event)]
    x11.XChangeProperty.argtypes = [c_void_p, c_ulong, c_ulong, c_ulong, c_int, c_int, c_char_p, c_int]
    x11.XNextEvent.argtypes = [c_void_p, POINTER(Event)]
    x11.XPending.argtypes = x11.XFlush.argtypes = [c_void_p]
    return x11


class Client:
    """A connection to the display, with an invisible window."""

    def __init__(self, target: int) -> None:
        self.x11, self.target = libx11(), target
        self.display = self.x11.XOpenDisplay(None)
        if not self.display:
            raise SystemExit("no display")
        root = self.x11.XDefaultRootWindow(self.display)
        self.window = self.x11.XCreateSimpleWindow(self.display, root, 0, 0, 1, 1, 0, 0, 0)

    def atom(self, name: str) -> int:
        return self.x11.XInternAtom(self.display, name.encode(), 0)

    def send(self, name: str, *data: int) -> None:
        """A client message to the target window."""
        event = Event()
        event.client.type, event.client.window, event.client.format = CLIENT_MESSAGE, self.target, 32
        event.client.message_type = self.atom(name)
        for i, value in enumerate(data):
            event.client.data[i] = value
        self.x11.XSendEvent(self.display, self.target, 0, 0, byref(event))
        self.x11.XFlush(self.display)

    def wait_for(self, kind: int, message: str = "") -> Event:
        """The next event of a kind, and of a message type if one is given; others are passed over."""
        end, event = time.monotonic() + PATIENCE_S, Event()
        while time.monotonic() < end:
            if not self.x11.XPending(self.display):
                time.sleep(0.01)
                continue
            self.x11.XNextEvent(self.display, byref(event))
            if event.type == kind and (not message or event.client.message_type == self.atom(message)):
                return event
        raise SystemExit(f"the window does not answer with {message or kind}")

    def close(self) -> None:
        self.send("WM_PROTOCOLS", self.atom("WM_DELETE_WINDOW"), ANY_TIME)

    def drop(self, paths: list[Path]) -> None:
        """Enters, moves, is welcome, drops, hands the paths over, and is thanked."""
        selection = self.atom("XdndSelection")
        self.x11.XSetSelectionOwner(self.display, selection, self.window, ANY_TIME)
        self.send("XdndEnter", self.window, XDND_VERSION << 24, self.atom("text/uri-list"), 0, 0)
        self.send("XdndPosition", self.window, 0, 200 << 16 | 200, ANY_TIME, self.atom("XdndActionCopy"))
        if not self.wait_for(CLIENT_MESSAGE, "XdndStatus").client.data[1] & 1:
            raise SystemExit("the window takes no drops")
        self.send("XdndDrop", self.window, 0, ANY_TIME)
        request = self.wait_for(SELECTION_REQUEST).request
        uris = "".join(f"{path.resolve().as_uri()}\r\n" for path in paths).encode()
        place = request.requestor, request.property, request.target
        self.x11.XChangeProperty(self.display, *place, 8, PROP_MODE_REPLACE, uris, len(uris))
        answer = Event()
        answer.notify.type, answer.notify.requestor = SELECTION_NOTIFY, request.requestor
        answer.notify.selection, answer.notify.target = request.selection, request.target
        answer.notify.property, answer.notify.time = request.property, request.time
        self.x11.XSendEvent(self.display, request.requestor, 0, 0, byref(answer))
        self.x11.XFlush(self.display)
        if not self.wait_for(CLIENT_MESSAGE, "XdndFinished").client.data[1]:  # GLFW sends a length for the flag
            raise SystemExit("the window did not take them")


def main() -> None:
    what, window, *files = sys.argv[1:]
    if what == "paste":
        pixels, width, height = copykitten.paste_image()
        Image.frombytes("RGBA", (width, height), bytes(pixels)).save(files[0])
    elif what == "drop":
        Client(int(window)).drop([Path(file) for file in files])
    else:
        Client(int(window)).close()


if __name__ == "__main__":
    main()
