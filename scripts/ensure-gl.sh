#!/bin/sh
# Makes sure that OpenGL can be had without a display: libEGL and libGL. Where CI is set, also the programs that tests of
# the window and of the web page need, for nothing may be skipped there. Installs them with apt where that is permitted;
# otherwise prints the line to type and stops.
set -u
[ "$(uname -s)" = Linux ] || exit 0

has_library() {
    PATH="$PATH:/sbin" ldconfig -p 2>/dev/null | grep -q "$1"
}

needed=""
has_library libEGL.so.1 || needed="$needed libegl1"
has_library libGL.so.1 || needed="$needed libgl1"
if [ -n "${CI:-}" ]; then
    command -v Xvfb >/dev/null 2>&1 || needed="$needed xvfb"
    command -v xdotool >/dev/null 2>&1 || needed="$needed xdotool"
    command -v setxkbmap >/dev/null 2>&1 || needed="$needed x11-xkb-utils"
    command -v chromium >/dev/null 2>&1 || command -v google-chrome >/dev/null 2>&1 || needed="$needed chromium"
fi
[ -n "$needed" ] || exit 0

line="apt-get install -y --no-install-recommends$needed"
if command -v apt-get >/dev/null 2>&1; then
    sudo=""
    [ "$(id -u)" = 0 ] || sudo="sudo -n"
    if [ -z "$sudo" ] || $sudo true 2>/dev/null; then
        echo "installing$needed"
        { $sudo apt-get update -qq && DEBIAN_FRONTEND=noninteractive $sudo $line -qq; } >/dev/null 2>&1 && exit 0
    fi
    echo "missing:$needed; type this, then run make again:  sudo $line" >&2
else
    echo "missing:$needed (Debian's names); install them with your package manager, then run make again" >&2
fi
exit 2
