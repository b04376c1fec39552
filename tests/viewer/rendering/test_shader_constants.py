"""The numbers that Python and GLSL share: shaders see Python's values."""

from pathlib import Path

import moderngl
import numpy as np
import pytest

from scenepack import constants
from viewer.rendering.shader_source import assemble, compile_program, shared_constants

NAMES = [line.split()[1] for line in shared_constants().splitlines()]
DERIVED = {"VIEW_INPUTS": constants.VIEW_MLP_WIDTHS[0], "VIEW_HIDDEN": constants.VIEW_MLP_WIDTHS[1], "PI": np.pi}


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
