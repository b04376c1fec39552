"""Shader text: includes, constants, and the weights of the view MLP.

A shader is written as `#version` line, `#define` lines made here, then the file with every `#include "name"` replaced,
once, by that file or by a generated text of that name.

Only numbers that went through `glsl_float` reach the text. Weights are input-major, [inputs, outputs]; GLSL matrices
are filled column by column and a column holds the weights of one input, so rows of the array are columns of the matrix.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from scenepack import constants
from scenepack.pack import ViewMlp

SHADER_FOLDER = Path(__file__).resolve().parents[2] / "shaders"
INCLUDE = re.compile(r'^#include "([^"]+)"$', re.MULTILINE)
VERSION = re.compile(r"^#version.*$", re.MULTILINE)


def glsl_float(value: float) -> str:
    """A finite number as a GLSL literal that reads back as the same float32. ValueError for others."""
    number = float(np.float32(value))
    if not np.isfinite(number):
        raise ValueError(f"{value!r} cannot be written into a shader")
    text = f"{number:.9g}"
    return text if any(mark in text for mark in ".e") else text + ".0"


def glsl_vec3(values: Iterable[float]) -> str:
    return f"vec3({', '.join(map(glsl_float, values))})"


def define_lines(defines: Mapping[str, object]) -> str:
    """`#define` lines: floats as literals, True as a bare name, False left out, integers as they are."""
    lines = []
    for name, value in defines.items():
        if value is False:
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


def assemble(name: str, defines: Mapping[str, object] | None = None, generated: Mapping[str, str] | None = None) -> str:
    """The shader `name` with its includes in place and `defines` behind its #version line.

    generated: texts to include that are no files; "constants" is always there.
    """
    texts = {"constants": shared_constants(), **(generated or {})}
    included: set[str] = set()

    def whole(piece: str) -> str:
        if piece in included:
            return ""
        included.add(piece)
        text = texts[piece] if piece in texts else (SHADER_FOLDER / piece).read_text(encoding="utf-8")
        return INCLUDE.sub(lambda include: whole(include[1]), text)

    return VERSION.sub(lambda version: f"{version[0]}\n{define_lines(defines or {})}", whole(name), count=1)


ES_PRECISION = "".join(
    f"precision highp {kind};\n" for kind in ("float", "int", "sampler2D", "sampler3D", "usampler3D")
)


def assemble_es(name: str, generated: Mapping[str, str] | None = None) -> str:
    """The shader `name` for WebGL 2, without comments: what follows `#version 300 es` and the lines of define_lines.

    generated: as assemble() takes it; an empty text in place of a file leaves out what its options never need.
    """
    text = assemble(name, None, generated)
    lines = (re.sub(r"\s*//.*", "", line).rstrip() for line in text.splitlines())
    kept = [line for line in lines if line and not line.startswith("#version")]
    return ES_PRECISION + "\n".join(kept) + "\n"


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


def view_mlp_includes(mlp: ViewMlp | None) -> dict[str, str]:
    """The includes that shaders/view_mlp.glsl and view_mlp_textures.glsl describe; empty texts without a view MLP."""
    functions, biases = [], []
    for layer, (weights, bias) in enumerate(zip(mlp.weights, mlp.biases, strict=True) if mlp else ()):
        outputs = [slice(4 * j, 4 * j + 4) for j in range(-(-len(bias) // 4))]
        for j, out in enumerate(outputs):
            vectors = HIDDEN if layer else INPUTS
            functions.append(_layer(f"layer_{layer}_{j}", vectors, weights[:, out], bias[out]))
        padded = np.pad(bias, (0, -len(bias) % 4))
        texts = ", ".join(f"vec4({_numbers(padded[out])})" for out in outputs)
        biases.append(f"const vec4 BIAS_{layer}[{len(outputs)}] = vec4[]({texts});\n")
    return {"view_mlp_weights": "\n".join(functions), "view_mlp_biases": "".join(biases)}
