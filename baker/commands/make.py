"""`snerg-make PHOTOS --out DIR`: photographs or a film to fly-through in one line (docs/commands.md)."""

import dataclasses
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from baker.baking.config import BakeConfig, Quality
from console import Notice, UserError, check_results, notify, run_command, write_json
from console.child_process import module_command
from console.desktop import has_display
from console.progress import duration
from scenepack.constants import CodecName
from training.libraries import begin_libraries
from training.posing.check import check as check_photographs
from training.posing.find import FRAMES, SCENE, posed_scene
from training.scenes.presets import BAKED_AS_THE_PAPER, PRESETS, BakeablePreset, names_with_about
from training.scenes.sources import FEWEST, require_source

PRESET_HELP = f"Named settings: {names_with_about(BakeablePreset)}."


def snerg_make(
    scene: Path,
    /,
    out: Path,
    preset: Annotated[BakeablePreset, tyro.conf.arg(help=PRESET_HELP)] = "normal",
    downscale: int | None = None,
    spherify: bool = False,
    masks: bool = False,
    aabb: str | None = None,
    up: str | None = None,
    steps: int | None = None,
    resolution: int | None = None,
    codec: CodecName = "png",
    quality: Quality = BakeConfig.quality,
    exposure: Literal["auto", "on", "off"] = "auto",
    seed: int = 0,
    frames: int = FRAMES,
    find_poses: bool = False,
    poses_only: bool = False,
    check: bool = False,
    json: Path | None = None,
    previews: float = 0.0,
    no_view: bool = False,
) -> None:
    """Turns photographs or a film into a scene that you can fly through: finds camera poses, trains, bakes, and opens the viewer.
    If it stops, the same command line continues.

    Args:
        scene: Folder of photographs, or a film. If the folder has no camera poses, they are found first. docs/scenes.md lists
            the layouts of folders with poses.
        out: Folder for the results: DIR/run and DIR/pack; and DIR/scene, where poses had to be found.
        downscale: Divide width and height of the photographs by this whole number. The default is 1; for the presets quick,
            normal and full, the smallest number that gives a longer side of at most 256, 512 or 1024 pixels. LLFF scenes count
            from their full-size pictures.
        spherify: Read an LLFF or COLMAP scene as a 360 degree scene although its cameras look forward.
        masks: Cut the object out with the masks next to the pictures.
        aabb: Box of the content, x0,y0,z0,x1,y1,z1 in the training frame. The default is the box that is printed when training
            starts. Not for forward-facing scenes, which are in NDC.
        up: What is up, x,y,z in the training frame as it is without this option. Only for COLMAP scenes, and photographs and
            films whose poses are found, that are seen from all around. The default is the mean up direction of the cameras.
        steps: Number of training steps. The default is the preset's.
        resolution: Voxels along the longest side of the content. The default is that of snerg-bake.
        codec: Codec of the pack: png (the published layout), webp (lossless, smaller), or jpeg, h264, avif (lossy).
        quality: draft (nothing is tuned), full (tuned, 8 bits), or compact (tuned, and stored in coarser steps: 30 %
            fewer bytes for about 0.1 dB less). compact is full where the codec is lossy. The presets paper, deferred, diffuse and
            no-sparsity are baked as the paper does, where the view MLP alone is tuned.
        exposure: Fit exposure and white balance of each photograph, so that the scene has their average look. auto: for
            photographs whose exposures differ, never for rendered scenes (Blender).
        seed: Random seed of the training, and of finding poses.
        frames: Number of frames of a film that are used, at most.
        find_poses: Find the camera poses even if the folder has some. Poses that a phone recorded may be wrong by several
            pixels, and LLFF scenes come without lens distortion.
        poses_only: Find camera poses into DIR/scene, and stop there.
        check: Look at the photographs, write DIR/check.html about them, and stop there: sharpness, overlap, exposure, what moves,
            which to take again, and the PSNR to expect.
        json: With --check, also write what was found to this file; "-" prints it instead of the text.
        previews: While training, write what is there so far to DIR/preview.zip, a small pack, every so many seconds; 0 for never.
            It is removed once DIR/pack is there.
        no_view: Do not open the viewer at the end.
    """
    if frames < FEWEST:
        expected = f"at least {FEWEST}"
        raise UserError("too few frames to find camera poses", where="--frames", expected=expected, found=frames)
    if json is not None and not check:
        raise UserError("needs --check", where="--json")
    if check:
        _check(scene, out, frames, json)
        return
    begin_libraries()
    from baker.baking.to_pack import PREVIEW_FILE, Previews, bake_to
    from scenepack import check_target
    from training.config import PRESETS as CONFIGS
    from training.config import require_valid
    from training.loop import train
    from training.run import is_run, read_description
    from training.scenes import SceneOptions, load_scene
    from training.scenes.read import suggested_downscale
    from training.scenes.scene_options import parse_box, parse_up

    box, upwards = parse_box(aabb), parse_up(up)
    run_path, pack_path = out / "run", out / "pack"
    check_target(pack_path)
    config = dataclasses.replace(CONFIGS[preset], seed=seed, exposure=exposure)
    if steps is not None:
        config = dataclasses.replace(config, steps=steps)
    require_valid(config)
    resolution = PRESETS[preset].resolution if resolution is None else resolution
    baking = BakeConfig(resolution, "paper" if preset in BAKED_AS_THE_PAPER else "snerg", quality)
    baking.check()
    began = time.monotonic()
    scene = posed_scene(scene, out, anew=find_poses, seed=seed, most_frames=frames)
    if poses_only:
        if scene != out / SCENE:
            load_scene(scene)  # else nothing would have looked at it
        print(f"the poses are in {scene}; {duration(time.monotonic() - began)}")
        return
    if not masks and scene == out / SCENE and (scene / "masks").is_dir():
        notify(Notice(f"{scene}: poses were found by the masks; --masks also cuts the object out"))
    started = time.monotonic()
    stored = read_description(run_path) if is_run(run_path) else None
    if stored is not None:
        if stored.scene != scene.resolve():
            raise UserError("holds a run of another scene", where=run_path, expected=scene, found=stored.scene,
                            remedy="choose another --out")  # fmt: skip
        stored.options.require_unchanged({"aabb": box, "up": upwards}, "leave it out, or choose another --out")
        asked = dataclasses.replace(config, engine=stored.config.engine)
        config = stored.config if steps is None else dataclasses.replace(stored.config, steps=steps)
        if asked != config:
            text = f"{run_path}: this run keeps its own settings; choose another --out to train with new ones"
            notify(Notice(text))
    else:
        downscale = downscale or suggested_downscale(scene, PRESETS[preset].longest_side)
    options = SceneOptions(downscale or 1, spherify or None, masks, box, upwards)
    shown = Previews(out / PREVIEW_FILE, previews)
    run = train(scene, run_path, config, options, resume=stored, after_step=shown.update if previews > 0 else None)
    trained = time.monotonic()
    bake_to(run, baking, pack_path, codec, last=True)
    shown.remove()
    baked = time.monotonic()
    posed = f"poses found in {duration(started - began)}, " if scene == out / SCENE else ""
    print(f"{posed}trained in {duration(trained - started)}, baked in {duration(baked - trained)}")
    if not no_view and has_display():
        # A process of its own: JAX holds most of a GPU's memory until this one ends.
        subprocess.Popen(module_command("snerg", "view", str(pack_path)))


def _check(scene: Path, out: Path, frames: int, json: Path | None) -> None:
    began, page = time.monotonic(), out / "check.html"
    check_results(page, json)
    verdict = check_photographs(require_source(scene), page, frames)
    if not write_json(json, {**verdict.figures, "page": str(page)}):
        print("\n".join([*verdict.lines(), f"the page is {page}; {duration(time.monotonic() - began)}"]))


def main(args: Sequence[str] | None = None) -> int:
    return run_command(snerg_make, prog="snerg-make", args=args)
