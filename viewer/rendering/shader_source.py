"""From GLSL files to one source text: includes, injected constants, and errors at the right file and line.

A shader is written as `#version` line, `#define` lines made here, then the file with every `#include "name"` replaced,
once, by that file or by a generated text of that name. `#line LINE FILE` directives keep count, where FILE is a number
(GLSL knows no file names) that `ShaderText.files` turns back into a name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import moderngl
import numpy as np

from scenepack import constants

SHADER_FOLDER = Path(__file__).resolve().parents[2] / "shaders"
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"\s*$')
# "0:12(5): error" Mesa; "0(12) : error" NVIDIA; "ERROR: 0:12:" Apple and ANGLE
ERROR_AT = re.compile(
    r"^(?P<head>(?:ERROR|WARNING):\s*)?(?P<file>\d+)(?::(?P<a>\d+)(?:\(\d+\))?|\((?P<b>\d+)\))\s*:", re.M
)


class ShaderError(Exception):
    """A shader that does not compile or link: a bug of ours, told with the file and line it is in."""


@dataclass(frozen=True)
class ShaderText:
    """GLSL ready to compile, and the names that its `#line` numbers stand for."""

    text: str
    files: tuple[str, ...]

    def locate(self, message: str) -> str:
        """A compiler's `message` with "file:line:" in place of the numbers that the driver printed."""

        def named(match: re.Match[str]) -> str:
            number, line = int(match["file"]), match["a"] or match["b"]
            name = self.files[number] if number < len(self.files) else f"source {number}"
            return f"{match['head'] or ''}{name}:{line}:"

        return ERROR_AT.sub(named, message)


def glsl_float(value: float) -> str:
    """A finite number as a GLSL literal that reads back as the same float32. ValueError for others."""
    number = float(np.float32(value))
    if not np.isfinite(number):
        raise ValueError(f"{value!r} cannot be written into a shader")
    text = f"{number:.9g}"
    return text if any(mark in text for mark in ".e") else text + ".0"


def glsl_reciprocals(sizes: Sequence[int]) -> str:
    """1 / x, 1 / y, 1 / z as a GLSL vec3."""
    return f"vec3({', '.join(glsl_float(1.0 / size) for size in sizes)})"


def define_lines(defines: Mapping[str, object]) -> str:
    """`#define` lines: floats as literals, True as a bare name, False and None left out, integers as they are."""
    lines = []
    for name, value in defines.items():
        if value is None or value is False:
            continue
        text = "" if value is True else f" {glsl_float(value)}" if isinstance(value, float) else f" {value}"
        lines.append(f"#define {name}{text}")
    return "\n".join(lines) + "\n"


def shared_constants() -> str:
    """The numbers of scenepack.constants as `#define` lines; the include "constants"."""
    shared = {
        name: value for name, value in vars(constants).items() if name.isupper() and isinstance(value, int | float)
    }
    inputs, hidden, *_ = constants.VIEW_MLP_WIDTHS
    return define_lines({**shared, "VIEW_INPUTS": inputs, "VIEW_HIDDEN": hidden, "PI": float(np.pi)})


def assemble(
    name: str,
    defines: Mapping[str, object] | None = None,
    generated: Mapping[str, str] | None = None,
    folder: Path = SHADER_FOLDER,
) -> ShaderText:
    """The shader `name` of `folder` with its includes in place and `defines` behind its #version line.

    generated: texts to include that are no files; "constants" is always there.
    FileNotFoundError (naming the line that asked) for an include that is neither.
    """
    texts = {"constants": shared_constants(), **(generated or {})}
    files: list[str] = []
    pieces: list[str] = []

    def add(piece: str, asked_by: str) -> None:
        if piece in files:
            return
        if piece not in texts and not (folder / piece).is_file():
            raise FileNotFoundError(f'{asked_by}: there is no shader file or generated text "{piece}" to include')
        number = len(files)
        files.append(piece)
        text = texts[piece] if piece in texts else (folder / piece).read_text(encoding="utf-8")
        if number:
            pieces.append(f"#line 1 {number}")
        for line_number, line in enumerate(text.splitlines(), 1):
            include = INCLUDE.match(line)
            if include:
                add(include[1], f"{piece}:{line_number}")
                pieces.append(f"#line {line_number + 1} {number}")
            elif line.startswith("#version"):
                # Comments may come before #version, nothing else; the rest of the file follows the definitions.
                pieces.append(line)
                pieces.append(define_lines(defines or {}).rstrip("\n"))
                pieces.append(f"#line {line_number + 1} {number}")
            else:
                pieces.append(line)

    add(name, "main shader")
    return ShaderText("\n".join(pieces) + "\n", tuple(files))


def compile_program(ctx: moderngl.Context, vertex: ShaderText, fragment: ShaderText) -> moderngl.Program:
    """Compiles and links. ShaderError with the file and line of each complaint."""
    try:
        return ctx.program(vertex_shader=vertex.text, fragment_shader=fragment.text)
    except moderngl.Error as error:
        message = str(error)
        blamed = vertex if "vertex_shader" in message and "fragment_shader" not in message else fragment
        raise ShaderError(blamed.locate(message)) from error


def colour_stops() -> tuple[tuple[float, float, float], ...]:
    """The colours (RGB, 0 … 1) that shaders/colour_map.glsl goes through from 0 to 1 in even steps, as it has them."""
    text = (SHADER_FOLDER / "colour_map.glsl").read_text()
    body = text[text.index("vec3 colour_map(") :].partition("\n}")[0]
    stops = []
    for found in re.findall(r"vec3\(([\d., ]+)\)", body):
        red, *others = (float(value) for value in found.split(","))
        green, blue = others or (red, red)
        stops.append((red, green, blue))
    return tuple(stops)
