"""Shader text: includes, constants, and the weights of the view MLP.

A shader is written as `#version` line, `#define` lines made here, then the file with every `#include "name"` replaced,
once, by that file or by a generated text of that name. `#line LINE FILE` directives keep count, where FILE is a number
(GLSL knows no file names) that `ShaderText.files` turns back into a name.

Only numbers that went through `glsl_float` reach the text. Weights are input-major, [inputs, outputs]; GLSL matrices
are filled column by column and a column holds the weights of one input, so rows of the array are columns of the matrix.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import moderngl
import numpy as np

from scenepack import constants
from scenepack.pack import ViewMlp

SHADER_FOLDER = Path(__file__).resolve().parents[2] / "shaders"
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"\s*$')
# "0:12(5): error" Mesa; "0(12) : error" NVIDIA; "ERROR: 0:12:" Apple and ANGLE
ERROR_AT = re.compile(
    r"^(?P<head>(?:ERROR|WARNING):\s*)?(?P<file>\d+)(?::(?P<a>\d+)(?:\(\d+\))?|\((?P<b>\d+)\))\s*:", re.M
)


class ShaderError(Exception):
    """A shader that does not compile or link: a bug of ours, with the file and line it is in."""


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
    named = vars(constants).items()
    shared = {name: value for name, value in named if name.isupper() and isinstance(value, int | float)}
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


ES_TYPES = ("float", "int", "sampler2D", "sampler3D", "usampler3D")
ES_PRECISION = "".join(f"precision highp {kind};\n" for kind in ES_TYPES)


def assemble_es(name: str, generated: Mapping[str, str] | None = None) -> str:
    """The shader `name` for WebGL 2, without comments: what follows `#version 300 es` and the lines of define_lines.

    generated: as assemble() takes it; an empty text in place of a file leaves out what its options never need.
    """
    text = assemble(name, None, generated).text
    lines = (re.sub(r"\s*//.*", "", line).rstrip() for line in text.splitlines())
    kept = [line for line in lines if line and not line.startswith(("#version", "#line"))]
    return ES_PRECISION + "\n".join(kept) + "\n"


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
    text = (SHADER_FOLDER / "colour_map.glsl").read_text(encoding="utf-8")
    body = text[text.index("vec3 colour_map(") :].partition("\n}")[0]
    stops = []
    for found in re.findall(r"vec3\(([\d., ]+)\)", body):
        red, *others = (float(value) for value in found.split(","))
        green, blue = others or (red, red)
        stops.append((red, green, blue))
    return tuple(stops)


# --- GLSL text made from a pack's view MLP ---

# The vectors that a layer is given, in its order, and their lengths.
INPUTS = dict.fromkeys(("v", "s1", "s2", "s4", "s8", "c1", "c2", "c4", "c8", "rgb"), 3) | {"features": 4}
HIDDEN: dict[str, int] = {"h0": 4, "h1": 4, "h2": 4, "h3": 4}


def _numbers(values: np.ndarray) -> str:
    return ", ".join(glsl_float(value) for value in np.ravel(values))


def _layer(name: str, vectors: Mapping[str, int], weights: np.ndarray, bias: np.ndarray) -> str:
    """A function of `vectors` that multiplies them by weights [inputs, outputs] and adds the bias [outputs]."""
    parameters = ", ".join(f"vec{length} {vector}" for vector, length in vectors.items())
    parts = np.split(weights, np.cumsum(list(vectors.values()))[:-1])
    terms = [f"vec{len(bias)}({_numbers(bias)})"]
    for vector, part in zip(vectors, parts, strict=True):
        terms.append(f"mat{len(part)}x{len(bias)}({_numbers(part)}) * {vector}")
    total = "\n        + ".join(terms)
    return f"vec{len(bias)} {name}({parameters}) {{\n    return {total};\n}}\n"


def view_mlp_weights(mlp: ViewMlp) -> str:
    """The layers as GLSL functions with constant weights; see shaders/view_mlp.glsl for their names."""
    texts = []
    for layer, vectors in enumerate((INPUTS, HIDDEN)):
        for j in range(4):
            out = slice(4 * j, 4 * j + 4)
            texts.append(_layer(f"layer_{layer}_{j}", vectors, mlp.weights[layer][:, out], mlp.biases[layer][out]))
    return "\n".join([*texts, _layer("layer_2", HIDDEN, mlp.weights[2], mlp.biases[2])])


def view_mlp_biases(mlp: ViewMlp) -> str:
    """The biases as `const vec4 BIAS_L[]`, zero-padded to whole vectors."""
    lines = []
    for layer, bias in enumerate(mlp.biases):
        padded = np.zeros(-(-len(bias) // 4) * 4)
        padded[: len(bias)] = bias
        vectors = ", ".join(f"vec4({_numbers(row)})" for row in padded.reshape(-1, 4))
        lines.append(f"const vec4 BIAS_{layer}[{len(padded) // 4}] = vec4[]({vectors});")
    return "\n".join(lines) + "\n"
