"""GLSL text made from a pack's view MLP: the includes "view_mlp_weights" and "view_mlp_biases".

Only numbers that went through `glsl_float` reach the text. Weights are input-major, [inputs, outputs]; GLSL matrices
are filled column by column and a column holds the weights of one input, so rows of the array are columns of the matrix.
"""

from __future__ import annotations

import numpy as np

from scenepack.constants import FEATURES
from scenepack.pack import ViewMlp
from viewer.rendering.shader_source import glsl_float

DIRECTION_INPUTS = ("v", "s1", "s2", "s4", "s8", "c1", "c2", "c4", "c8", "rgb")  # vec3 each, in the inputs' order
LAYER_0_INPUTS = (*DIRECTION_INPUTS, "features")


def _numbers(values: np.ndarray) -> str:
    return ", ".join(glsl_float(value) for value in np.ravel(values))


def _product(weights: np.ndarray, name: str) -> str:
    """weights [inputs, outputs] times the vector `name`, as a GLSL expression."""
    inputs, outputs = weights.shape
    kind = f"mat{inputs}" if inputs == outputs else f"mat{inputs}x{outputs}"
    return f"{kind}({_numbers(weights)}) * {name}"


def _function(head: str, bias: np.ndarray, products: list[str]) -> str:
    terms = "\n        + ".join([f"vec{len(bias)}({_numbers(bias)})", *products])
    return f"{head} {{\n    return {terms};\n}}\n"


def view_mlp_weights(mlp: ViewMlp) -> str:
    """The layers as GLSL functions with constant weights; see shaders/view_mlp.glsl for their names."""
    texts = []
    inputs = ", ".join(f"vec3 {name}" for name in DIRECTION_INPUTS) + ", vec4 features"
    hidden = ", ".join(f"vec4 h{i}" for i in range(4))
    for j in range(4):
        out = slice(4 * j, 4 * j + 4)
        columns = [mlp.weights[0][3 * i : 3 * i + 3, out] for i in range(len(DIRECTION_INPUTS))]
        columns.append(mlp.weights[0][-FEATURES:, out])
        products = [_product(w, name) for w, name in zip(columns, LAYER_0_INPUTS, strict=True)]
        texts.append(_function(f"vec4 layer_0_{j}({inputs})", mlp.biases[0][out], products))
    for j in range(4):
        out = slice(4 * j, 4 * j + 4)
        products = [_product(mlp.weights[1][4 * i : 4 * i + 4, out], f"h{i}") for i in range(4)]
        texts.append(_function(f"vec4 layer_1_{j}({hidden})", mlp.biases[1][out], products))
    products = [_product(mlp.weights[2][4 * i : 4 * i + 4], f"h{i}") for i in range(4)]
    texts.append(_function(f"vec3 layer_2({hidden})", mlp.biases[2], products))
    return "\n".join(texts)


def view_mlp_biases(mlp: ViewMlp) -> str:
    """The biases as `const vec4 BIAS_L[]`, zero-padded to whole vectors."""
    lines = []
    for layer, bias in enumerate(mlp.biases):
        padded = np.zeros(-(-len(bias) // 4) * 4)
        padded[: len(bias)] = bias
        vectors = ", ".join(f"vec4({_numbers(row)})" for row in padded.reshape(-1, 4))
        lines.append(f"const vec4 BIAS_{layer}[{len(padded) // 4}] = vec4[]({vectors});")
    return "\n".join(lines) + "\n"
