"""The numbers that Python and GLSL share: shaders see Python's values, use them by name, and follow them."""

from __future__ import annotations

import re
from pathlib import Path

import moderngl
import numpy as np
import pytest

from scenepack import constants
from viewer.rendering.shader_source import SHADER_FOLDER, assemble, compile_program, shared_constants

NAMES = [line.split()[1] for line in shared_constants().splitlines()]
# Of the bytes in files alone; no shader reads files.
PYTHON_ONLY = {"EMPTY_BLOCK", "MAX_BLOCK_INDEX", "PLANES_PER_IMAGE"}
DERIVED = {
    "VIEW_INPUTS": constants.VIEW_MLP_WIDTHS[0],
    "VIEW_HIDDEN": constants.VIEW_MLP_WIDTHS[1],
    "PI": np.pi,
}
NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\.\d+(?:e[+-]?\d+)?|\d+(?:e[+-]?\d+)?)[uf]?(?![\w.])", re.I)


def code_of(path: Path) -> str:
    """A shader's text without its comments."""
    return re.sub(r"//.*|/\*.*?\*/", "", path.read_text(encoding="utf-8"))


def written_numbers(code: str) -> list[float]:
    """The literals of GLSL code, quotients of two literals, and negative powers included."""
    number = NUMBER.pattern
    quotients = re.findall(rf"{number}\s*/\s*{number}", code, re.I)
    return [float(text) for text in NUMBER.findall(code)] + [float(a) / float(b) for a, b in quotients if float(b)]


@pytest.mark.parametrize("name", NAMES)
def test_a_shader_computes_with_the_value_that_python_has(ctx: moderngl.Context, tmp_path: Path, name: str) -> None:
    (tmp_path / "all.vert").write_text(
        "#version 330 core\nin vec2 at;\nvoid main() { gl_Position = vec4(at, 0, 1); }\n"
    )
    fragment = f'#version 330 core\n#include "constants"\nout float value;\nvoid main() {{ value = float({name}); }}\n'
    (tmp_path / "one.frag").write_text(fragment)
    program = compile_program(ctx, *(assemble(file, folder=tmp_path) for file in ("all.vert", "one.frag")))
    target = ctx.framebuffer([ctx.texture((1, 1), 1, dtype="f4")])
    target.use()
    corners = ctx.buffer(np.array([-1, -1, 3, -1, -1, 3], "f4"))
    ctx.vertex_array(program, [(corners, "2f", "at")]).render(vertices=3)
    expected = DERIVED[name] if name in DERIVED else getattr(constants, name)
    assert np.frombuffer(target.read(components=1, dtype="f4"), np.float32)[0] == np.float32(expected)


def test_every_shared_number_reaches_the_shaders_and_is_used_there_by_name() -> None:
    shared = {name for name, value in vars(constants).items() if name.isupper() and isinstance(value, int | float)}
    assert set(NAMES) == shared | set(DERIVED)
    code = "\n".join(code_of(path) for path in SHADER_FOLDER.iterdir())
    used = {name for name in NAMES if re.search(rf"\b{name}\b", code)}
    assert used == set(NAMES) - PYTHON_ONLY
    assert not re.search(rf"#\s*define\s+({'|'.join(NAMES)})\b", code), "a shader redefines one"


def test_no_shared_number_is_written_out_again_in_a_shader() -> None:
    ones_own = {0.0, 1.0, 2.0, 3.0, 4.0, 16.0}  # of these it cannot be told what they mean
    shared = {name: float(getattr(constants, name)) for name in NAMES if name not in DERIVED} | {"a byte": 255.0}
    shared |= {"the largest byte but one": 254.0, **{name: float(value) for name, value in DERIVED.items()}}
    for path in SHADER_FOLDER.iterdir():
        for number in written_numbers(code_of(path)):
            for name, value in shared.items():
                same = abs(number - value) <= 2e-3 * value and value not in ones_own
                assert not same, f"{path.name} writes {number:g}, which is {name}"
