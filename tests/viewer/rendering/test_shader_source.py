"""Injected numbers, and shader errors that quote the line."""

from pathlib import Path

import numpy as np
import pytest

from viewer.rendering.shader_source import ShaderError, assemble, compile_program, glsl_float

VERTEX = "#version 330 core\nvoid main() { gl_Position = vec4(0.0); }\n"


def write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        (folder / name.replace("_", ".", 1)).write_text(text, encoding="utf-8")


def test_an_error_quotes_the_line_of_an_included_file_or_of_the_vertex_shader(ctx, tmp_path):
    write(
        tmp_path,
        main_vert=VERTEX,
        main_frag='// main\n#version 330 core\n#include "one.glsl"\nout vec4 c;\nvoid main() { c = one(); }\n',
        one_glsl='// one\n#include "two.glsl"\n\nvec4 one() {\n    return undeclared_in_one;\n}\n',
        two_glsl="const float TWO = 2.0;\n",
    )
    defines = {"A": 1, "B": 2.0, "C": True}
    vertex = assemble("main.vert", folder=tmp_path)
    with pytest.raises(ShaderError, match="return undeclared_in_one;"):
        compile_program(ctx, vertex, assemble("main.frag", defines, folder=tmp_path))
    write(tmp_path, bad_vert="#version 330 core\nvoid main() {\n    gl_Position = wrong;\n}\n")
    with pytest.raises(ShaderError, match="gl_Position = wrong;"):
        compile_program(ctx, assemble("bad.vert", folder=tmp_path), assemble("main.frag", defines, folder=tmp_path))


def test_numbers_survive_the_way_into_a_shader_and_nothing_else_does() -> None:
    for value in (0.0, -1.5, 1e-30, 3.4e38, 1 / 3, np.float32(0.1), 255, True):
        text = glsl_float(value)
        assert np.float32(text) == np.float32(value) and any(mark in text for mark in ".e")
    for value in (float("nan"), float("inf"), "1.0); discard; (", "0; }"):
        with pytest.raises(ValueError):
            glsl_float(value)  # type: ignore[arg-type]
