"""snerg-render and snerg-bench as a person or a script runs them."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack import Pack, load_pack
from scenepack.blocks import dense_from_pack
from tests.scenepack.helpers import written
from tests.scenepack.volumes import cube_pack
from tests.viewer.rendering import conftest as rendering
from tests.viewer.rendering.shapes import shapes_pack, surroundings_pack
from tests.viewer.scenes import SIDE, photographed
from viewer.benchmark.frames import same_view
from viewer.commands import bench, render
from viewer.rendering import offscreen
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer

SMALL = ["--size", "48x36"]
ctx, no_opengl_error_is_left = rendering.ctx, rendering.no_opengl_error_is_left  # fixtures


@pytest.fixture(scope="module")
def ndc_folder(tmp_path_factory: pytest.TempPathFactory, ndc_shapes: Pack) -> Path:
    return written(tmp_path_factory.mktemp("packs") / "ndc", ndc_shapes)


@pytest.fixture(autouse=True)
def our_context_again(ctx) -> Iterator[None]:
    """The commands make contexts of their own; the room's is current again behind each test."""
    yield
    ctx.__enter__()


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def rendered(pack: object, out: Path, *words: object) -> Path:
    """What snerg-render has written."""
    assert render.main([str(word) for word in (pack, "--out", out, *words)]) == 0
    return out


def benched(pack: object, out: Path, *words: object) -> dict:
    """What snerg-bench writes as JSON."""
    assert bench.main([str(word) for word in (pack, "--json", out, *SMALL, *words)]) == 0
    return json.loads(out.read_text())


def test_one_picture_from_a_pose_with_negative_numbers(shapes_folder: Path, tmp_path: Path) -> None:
    pose = ["--eye", "-2,1,-2", "--target", "0,-0.2,0", "--up", "0,1,0", "--fov", "45"]
    out = rendered(shapes_folder, tmp_path / "deep" / "one.png", *pose, *SMALL)
    assert picture(out).shape == (36, 48, 3) and picture(out).std() > 5
    assert not [path for path in out.parent.iterdir() if path != out]


def test_360_degrees_as_a_picture_and_two_eyes_as_stereo(shapes_folder: Path, tmp_path: Path) -> None:
    pose = ["--eye", "0.1,-0.2,0.1", "--target", "1,-0.2,0.4"]
    eyes = ["--eye-distance", "0.2"]
    shapes = {"one": ("equirectangular", 64, []), "above": ("equirectangular", 64, eyes), "beside": ("vr180", 32, eyes)}
    seen = {}
    for name, (projection, width, more) in shapes.items():
        words = [*pose, "--projection", projection, "--size", f"{width}x32", *more]
        seen[name] = picture(rendered(shapes_folder, tmp_path / f"{name}.png", *words)).astype(int)
    assert [each.shape[:2] for each in seen.values()] == [(32, 64), (64, 64), (32, 64)]
    left, right = seen["above"][:32], seen["above"][32:]
    assert np.abs(left - right).mean() > 1 and np.abs(left - seen["one"]).mean() < np.abs(left - right).mean()
    assert np.array_equal(seen["beside"][:, :32], left[:, 16:48])  # the half that lies ahead
    assert np.array_equal(seen["beside"][:, 32:], right[:, 16:48])


def test_several_views_are_a_folder_a_sheet_or_a_film(shapes_folder: Path, tmp_path: Path) -> None:
    sheet = picture(rendered(shapes_folder, tmp_path / "sheet.png", "--sheet", "--orbit", 5, *SMALL))
    each = rendered(shapes_folder, tmp_path / "each", "--orbit", 5, *SMALL)
    assert sorted(path.name for path in each.iterdir()) == [f"{i:04d}.png" for i in range(5)]
    assert sheet.shape == (2 * 44 + 8, 3 * 56 + 8, 3)
    for i in range(5):
        x, y = 8 + 56 * (i % 3), 8 + 44 * (i // 3)
        assert np.array_equal(sheet[y : y + 36, x : x + 48], picture(each / f"{i:04d}.png"))
    pytest.importorskip("av", reason="PyAV is not installed: pip install 'snerg[video]'")
    assert rendered(shapes_folder, tmp_path / "turn.mp4", "--orbit", 3, "--size", "49x37").stat().st_size > 500


def test_forward_facing_packs_render_without_a_pose_but_no_360_pictures(ndc_folder, tmp_path, refused):
    assert picture(rendered(ndc_folder, tmp_path / "a.png", "--fov", 50, *SMALL)).std() > 5
    words = "--out", tmp_path / "b.png", "--projection", "equirectangular"
    assert "perspective view alone" in refused(render.main, ndc_folder, *words) and not words[1].exists()


def test_the_surroundings_of_a_contracted_pack_can_be_left_out(tmp_path: Path) -> None:
    pack = written(tmp_path / "pack", surroundings_pack(64))
    whole, inner = (
        picture(rendered(pack, tmp_path / "a.png", *words, *SMALL)) for words in ((), ("--no-surroundings",))
    )
    assert (inner == 255).all(axis=2).mean() > 0.3 and (whole == 255).all(axis=2).mean() < 0.01
    figures = benched(pack, tmp_path / "figures.json", "--frames", 2, "--no-surroundings", "--compare", "paper")
    assert 15 < figures["compare"]["psnr"] < 60


@pytest.mark.parametrize(("folder", "mode"), [("shapes_folder", "rgb"), ("ndc_folder", "alpha")])
def test_samples_smooth_a_picture_into_the_mean_of_a_larger_one(request, folder, mode, tmp_path: Path) -> None:
    pack, words = request.getfixturevalue(folder), ["--mode", mode]
    smooth = picture(rendered(pack, tmp_path / "smooth.png", *words, "--samples", 4, *SMALL))
    large = picture(rendered(pack, tmp_path / "large.png", *words, "--size", "192x144"))
    mean = large.astype(float).reshape(36, 4, 48, 4, 3).mean(axis=(1, 3))
    assert np.abs(smooth - mean).max() <= 1.01 and mean.std() > 5  # both are rounded to 8 bits


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("a.jpg", "supported file type"),
        ("a.png --orbit 2", "cannot hold 2 pictures"),
        ("a.png --eye 1,2,nan", "--eye"),
        ("a.png --eye 1,2,3 --target 1,2,3", "--target"),
        ("a.png --size 0x5", "--size"),
        ("a.png --crop 1,2,3", "--crop"),
        ("a.png --scene nowhere", "nowhere"),
        ("a.png --samples 17", "--samples"),
        ("a.png --projection equirectangular --size 64x64", "--size"),
        ("a.png --projection equirectangular --fov 40", "--fov"),
        ("a.png --projection vr180", "--eye-distance"),
        ("a --sheet --orbit 2", "no contact sheet"),
        ("a.png --eye-distance 0.1", "--eye-distance"),
        ("a.exr --projection equirectangular --eye-distance 0.1", ""),
        ("a.png --focus 2", "needs --aperture"),
        ("a.png --aperture 0", "--aperture"),
        ("a.png --aperture nan", "--aperture"),
        ("a.png --aperture 0.1 --focus -1", "--focus"),
        ("a.png --aperture 0.1 --lens-rays 2", "--lens-rays"),
        ("a.png --aperture 0.1 --ortho-height 2", "exclude each other"),
        ("a.png --aperture 0.1 --eye 0,0,3 --target 0,0,9", "--focus"),
        ("a.png --mode rgb,depth", "several modes"),
        ("a.mp4 --background transparent", "transparent"),
        ("a.exr --orbit 2", "cannot hold 2 pictures"),
        ("a.exr --mode rgb,rgb", "twice"),
        ("a.exr --mode rgb,colour", "is no display mode"),
        ("a.png --background clear", "--background"),
    ],
)
def test_bad_arguments_are_status_2_and_one_line(shapes_folder, tmp_path, monkeypatch, refused, words, complaint):
    monkeypatch.chdir(tmp_path)
    assert complaint in refused(render.main, shapes_folder, "--out", *words.split())
    assert not list(tmp_path.iterdir())


def exr(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Header and channels, read by another library than the writer's."""
    openexr = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'snerg[dev]'")
    file = openexr.File(str(path), separate_channels=True)
    return file.header(), {name: channel.pixels for name, channel in file.channels().items()}


def test_one_exr_holds_picture_depth_normals_and_opacity(shapes_folder: Path, tmp_path: Path) -> None:
    header, channels = exr(rendered(shapes_folder, tmp_path / "F.exr", "--mode", "rgb,depth,normal,alpha", *SMALL))
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


def test_an_exr_without_opacity_has_the_picture_over_its_background(shapes_folder: Path, tmp_path: Path) -> None:
    words = ["--background", "0.5,0.5,0.5", "--mode", "rgb,samples", *SMALL]
    _, channels = exr(rendered(shapes_folder, tmp_path / "F.exr", *words))
    assert set(channels) == {"R", "G", "B", "samples"}
    assert np.allclose(channels["R"][0, 0], 0.21404, atol=1e-4)
    assert channels["samples"].max() > 2 and np.all(channels["samples"] == np.rint(channels["samples"]))


def test_a_transparent_png_has_straight_alpha_and_laid_over_white_it_is_the_picture(shapes_folder, tmp_path):
    white = picture(rendered(shapes_folder, tmp_path / "white.png", "--mode", "diffuse", *SMALL))
    words = ["--background", "transparent", "--mode", "diffuse", *SMALL]
    seen = Image.open(rendered(shapes_folder, tmp_path / "clear.png", *words))
    assert seen.mode == "RGBA" and seen.getpixel((0, 0)) == (0, 0, 0, 0)
    over = Image.alpha_composite(Image.new("RGBA", seen.size, "white"), seen).convert("RGB")
    assert np.abs(np.asarray(over, int) - white.astype(int)).max() <= 2


def test_a_folder_gets_a_file_for_each_mode_of_each_view_or_one_exr_for_each_view(shapes_folder, tmp_path):
    words = ["--orbit", 2, "--mode", "rgb,alpha,normals", "--background", "transparent", *SMALL]
    png, layered = (rendered(shapes_folder, tmp_path / kind, *words, "--format", kind) for kind in ("png", "exr"))
    names = {f"{view}_{mode}.png" for view in ("0000", "0001") for mode in ("rgb", "alpha", "normals")}
    assert {path.name for path in png.iterdir()} == names
    assert Image.open(png / "0001_rgb.png").mode == "RGBA"
    assert {path.name for path in layered.iterdir()} == {"0000.exr", "0001.exr"}


def test_the_benchmarks_json_has_what_scripts_expect_and_its_table_each_way_to_draw(shapes_folder, tmp_path, capsys):
    result = benched(shapes_folder, tmp_path / "a.json", "--frames", 4, "--compare", "paper", "--ablations")
    promised = {"renderer", "width", "height", "frames", "ms_mean", "ms_std", "ms_p50", "ms_p95", "fps", "gpu_bytes"}
    assert promised | {"watts", "compare"} <= set(result)
    assert (result["width"], result["height"], result["frames"]) == (48, 36, 4)
    compare = result["compare"]
    assert compare["ratio"] == pytest.approx(compare["paper"]["ms_p50"] / result["ms_p50"])
    assert 15 < compare["psnr"] < 60 and result["gpu_bytes"] > 0
    assert len(result["ablations"]) == 3
    printed = capsys.readouterr().out
    rows = [line.split("│")[1].strip() for line in printed.splitlines() if line.startswith("│")]
    expected = "exact", "paper", "exact, no view MLP", "exact, view MLP at every sample", "no skipping: every sample"
    assert "p99" in printed and rows == [*expected]


@pytest.fixture(scope="module")
def turned_folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The same scene as another system might have made it: without features, in a grid that is turned by half about y."""
    plain = shapes_pack(diffuse=True)
    rgba = np.ascontiguousarray(dense_from_pack(plain)[0][::-1, :, ::-1])
    frame = plain.worldspace_T_opengl @ np.diag([-1.0, 1.0, -1.0, 1.0])
    return str(written(tmp_path_factory.mktemp("packs") / "turned", cube_pack(rgba, plain.block_size, frame)))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, shapes: Pack) -> str:
    """A scene of two photographs to test by: pictures of the pack with noise on them."""
    folder, rng = tmp_path_factory.mktemp("scene") / "noisy", np.random.default_rng(0)
    with OffscreenRenderer(shapes) as renderer:

        def noisy(view: ViewCamera) -> np.ndarray:
            seen = renderer.render(view)
            return np.clip(seen + rng.integers(-9, 10, seen.shape), 0, 255).astype(np.uint8)

        photographed(shapes, folder, 2, noisy, distance=4.03)  # beyond the near plane of such scenes
    return str(folder)


@pytest.mark.slow
def test_two_systems_are_compared_under_their_own_marchers_and_against_photographs(
    shapes_folder, turned_folder, scene, tmp_path, capsys
):
    out, words = tmp_path / "bench.json", ["--against", turned_folder, "--scene", scene, "--frames", 3]
    result = benched(shapes_folder, out, *words)
    assert "compare" not in result and "ablations" not in result
    against, shown = result["against"], result["photographs"]
    assert against["systems"] == ["shapes, exact", "turned, paper"]
    assert against["ratio"] == pytest.approx(against["ms_p50"] / result["ms_p50"])
    assert 0 < against["ratio_p5"] <= against["ratio_p95"]
    assert (shown["views"], shown["width"], shown["height"]) == (2, SIDE, SIDE)
    assert 30 < shown["psnr"] < 40  # the noise; the photographs were made from this pack
    assert 10 < against["psnr"] < shown["psnr"] - 2
    printed = " ".join(capsys.readouterr().out.split())
    assert "as fast as turned, paper" in printed and "2 photographs" in printed
    again = benched(shapes_folder, out, *words, "--algorithms", "brute,exact")
    assert again["against"]["systems"] == ["shapes, brute", "turned, exact"]
    assert again["photographs"]["psnr"] == pytest.approx(shown["psnr"], abs=0.05)


def test_a_pack_in_another_grid_frame_is_seen_by_the_same_cameras(turned_folder: str) -> None:
    """Without its frame, it would be seen from behind."""
    pack, turned = shapes_pack(diffuse=True), load_pack(Path(turned_folder))
    camera = ViewCamera.orbit(pack, 35.0, 28.0, 2.9, size=(48, 36))
    with OffscreenRenderer(pack) as ours, OffscreenRenderer(turned, ctx=ours.ctx) as theirs:
        expected = ours.render(camera).astype(int)
        actual = theirs.render(same_view(camera, pack, turned)).astype(int)
        assert np.abs(actual - expected).mean() < 0.5 < np.abs(theirs.render(camera) - expected).mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["--algorithms", "exact,exact"],
        ["--against", "PACK", "--algorithms", "exact"],
        ["--against", "NDC"],
        ["--scene", "SCENE", "--split", "val"],
        ["--protocol", "forward-facing"],
        ["--frames", "0"],
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_line(shapes_folder, ndc_folder, scene, tmp_path, refused, words):
    places = {"PACK": shapes_folder, "NDC": ndc_folder, "SCENE": scene}
    words = [places.get(word, word) for word in words]
    refused(bench.main, shapes_folder, "--frames", 1, *words, "--json", tmp_path / "a.json", *SMALL)
    assert not list(tmp_path.iterdir())


def test_a_context_that_is_lost_is_one_line(shapes_folder, tmp_path, monkeypatch, refused):
    monkeypatch.setattr(offscreen, "lost", lambda ctx: True)
    assert "was lost" in refused(render.main, shapes_folder, "--out", tmp_path / "a.png", *SMALL)


def test_the_protocol_follows_the_pack_and_a_wrong_one_is_refused(ndc_folder: Path, tmp_path: Path, refused) -> None:
    assert benched(ndc_folder, tmp_path / "bench.json", "--frames", 2)["protocol"] == "forward-facing"
    refused(bench.main, ndc_folder, "--protocol", "synthetic")
