"""snerg-render's transparent pictures, OpenEXR files and several modes at once, opened with other libraries than the writer's."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from viewer.commands import render

OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'snerg[dev]'")
SMALL = ["--size", "48x36"]


def exr(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    file = OpenEXR.File(str(path), separate_channels=True)
    return file.header(), {name: channel.pixels for name, channel in file.channels().items()}


def test_one_exr_holds_picture_depth_normals_and_opacity(folder: str, tmp_path: Path) -> None:
    out = tmp_path / "F.exr"
    assert render.main([folder, "--out", str(out), "--mode", "rgb,depth,normal,alpha", *SMALL]) == 0
    header, channels = exr(out)
    assert set(channels) == {"R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"}
    assert all(values.dtype == np.float32 and values.shape == (36, 48) for values in channels.values())
    said = json.loads(header["snerg"])
    assert "optical axis" in said["Z"] and "without background" in said["RGB"]
    solid, empty = channels["A"] > 0.9, channels["A"] == 0
    assert solid.any() and empty.any()
    assert not any(values[empty].any() for values in channels.values())
    length = np.sqrt(sum(channels[f"N.{axis}"] ** 2 for axis in "XYZ"))
    assert np.allclose(length[solid], 1, atol=1e-4)
    # Where these depths are, by the camera that the header has, lies within the box of -1 ... 1.
    y, x = np.nonzero(solid)
    z = channels["Z"][y, x]
    across, up = (x + 0.5 - said["cx"]) / said["fx"] * z, -(y + 0.5 - said["cy"]) / said["fy"] * z
    matrix = np.array(said["grid_T_camera"])
    points = np.stack([across, up, -z], 1) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.abs(points).max() < 1.02 and np.ptp(points, axis=0).min() > 0.4
    assert np.allclose(header["worldToCamera"].T @ matrix, np.eye(4), atol=1e-5)


def test_an_exr_without_opacity_has_the_picture_over_its_background(folder: str, tmp_path: Path) -> None:
    words = [folder, "--out", str(tmp_path / "F.exr"), "--background", "0.5,0.5,0.5", "--mode", "rgb,samples", *SMALL]
    assert render.main(words) == 0
    _, channels = exr(tmp_path / "F.exr")
    assert set(channels) == {"R", "G", "B", "samples"}
    assert np.allclose(channels["R"][0, 0], 0.21404, atol=1e-4)
    assert channels["samples"].max() > 2 and np.all(channels["samples"] == np.rint(channels["samples"]))


def test_a_transparent_png_has_straight_alpha_and_laid_over_white_it_is_the_picture(folder, tmp_path):
    clear, white = tmp_path / "clear.png", tmp_path / "white.png"
    assert render.main([folder, "--out", str(clear), "--background", "transparent", "--mode", "diffuse", *SMALL]) == 0
    assert render.main([folder, "--out", str(white), "--mode", "diffuse", *SMALL]) == 0
    picture = Image.open(clear)
    assert picture.mode == "RGBA" and picture.getpixel((0, 0)) == (0, 0, 0, 0)
    over = Image.alpha_composite(Image.new("RGBA", picture.size, "white"), picture).convert("RGB")
    assert np.abs(np.asarray(over, int) - np.asarray(Image.open(white), int)).max() <= 2


def test_a_folder_gets_a_file_for_each_mode_of_each_view_or_one_exr_for_each_view(folder: str, tmp_path: Path) -> None:
    words = [folder, "--orbit", "2", "--mode", "rgb,alpha,normals", "--background", "transparent", *SMALL]
    assert render.main([*words, "--out", str(tmp_path / "png")]) == 0
    names = {f"{view}_{mode}.png" for view in ("0000", "0001") for mode in ("rgb", "alpha", "normals")}
    assert {path.name for path in (tmp_path / "png").iterdir()} == names
    assert Image.open(tmp_path / "png" / "0001_rgb.png").mode == "RGBA"
    assert render.main([*words, "--out", str(tmp_path / "exr"), "--format", "exr"]) == 0
    assert {path.name for path in (tmp_path / "exr").iterdir()} == {"0000.exr", "0001.exr"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "a.png", "--mode", "rgb,depth"], "several modes"),
        (["--out", "a.mp4", "--background", "transparent"], "transparent"),
        (["--out", "a.exr", "--orbit", "2"], "cannot hold 2 pictures"),
        (["--out", "a.exr", "--mode", "rgb,rgb"], "twice"),
        (["--out", "a.exr", "--mode", "rgb,colour"], "is no display mode"),
        (["--out", "a.png", "--background", "clear"], "--background"),
    ],
)
def test_what_files_cannot_hold_is_told_in_one_line(folder, words, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert render.main([folder, *words, *SMALL]) == 2
    line = capsys.readouterr().err.strip()
    assert message in line and "\n" not in line
    assert not list(tmp_path.iterdir())
