"""Injected numbers, and the constants of Python in shaders."""

from pathlib import Path

import moderngl
import numpy as np
import pytest

from scenepack import constants
from viewer.rendering.shader_source import assemble, compile_program, glsl_float, shared_constants


def test_numbers_survive_the_way_into_a_shader_and_nothing_else_does() -> None:
    for value in (0.0, -1.5, 1e-30, 3.4e38, 1 / 3, np.float32(0.1), 255, True):
        text = glsl_float(value)  # type: ignore[arg-type]  (NumPy's scalars are numbers, too)
        assert np.float32(text) == np.float32(value) and any(mark in text for mark in ".e")
    for value in (float("nan"), float("inf"), "1.0); discard; (", "0; }"):
        with pytest.raises(ValueError):
            glsl_float(value)  # type: ignore[arg-type]


# The numbers that Python and GLSL share: shaders see Python's values

NAMES = [line.split()[1] for line in shared_constants().splitlines()]
DERIVED = {"VIEW_INPUTS": constants.VIEW_MLP_WIDTHS[0], "VIEW_HIDDEN": constants.VIEW_MLP_WIDTHS[1], "PI": np.pi}


@pytest.mark.parametrize("name", NAMES)
def test_a_shader_computes_with_the_value_that_python_has(ctx: moderngl.Context, tmp_path: Path, name: str) -> None:
    vertex = "#version 330 core\nin vec2 at;\nvoid main() { gl_Position = vec4(at, 0, 1); }\n"
    (tmp_path / "all.vert").write_text(vertex)
    fragment = f'#version 330 core\n#include "constants"\nout float value;\nvoid main() {{ value = float({name}); }}\n'
    (tmp_path / "one.frag").write_text(fragment)
    program = compile_program(ctx, *(assemble(file, folder=tmp_path) for file in ("all.vert", "one.frag")))
    target = ctx.framebuffer([ctx.texture((1, 1), 1, dtype="f4")])
    target.use()
    corners = ctx.buffer(np.array([-1, -1, 3, -1, -1, 3], "f4"))
    ctx.vertex_array(program, [(corners, "2f", "at")]).render(vertices=3)
    expected = DERIVED[name] if name in DERIVED else getattr(constants, name)
    assert np.frombuffer(target.read(components=1, dtype="f4"), np.float32)[0] == np.float32(expected)
