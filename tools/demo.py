"""`make demo`: the bundled demo pack from nothing, through the real trainer and baker.

    python -m tools.demo --out viewer/demo/demo.zip

Renders the procedural island (tools.procedural), trains on it with the preset `quick`, bakes, writes the zip.
"""

import dataclasses
import shutil
import sys
import tempfile
from pathlib import Path

from console import run_command
from training.libraries import begin_libraries

SIZE, VIEWS, STEPS, RESOLUTION = 400, 96, 6000, 400
COPIES = 200  # pixels a side of the photographs' copies in the pack


def demo(out: Path, work: Path | None = None, steps: int = STEPS, resolution: int = RESOLUTION) -> None:
    """Makes the bundled demo pack again.

    Args:
        out: The .zip to write.
        work: Folder for the scene and the run, which stay there. The default is a temporary folder, which is removed.
        steps: Number of training steps.
        resolution: Voxels along the longest side of the content.
    """
    begin_libraries()  # JAX starts here, not for --help
    from baker.baking.bake import bake
    from baker.baking.config import BakeConfig
    from baker.baking.to_pack import describe_pack, with_pictures
    from scenepack import check_target, save_pack
    from tools.procedural import write_procedural_scene
    from training.config import PRESETS
    from training.loop import train

    check_target(out)
    folder = work or Path(tempfile.mkdtemp(prefix="snerg-demo-"))
    try:
        scene = write_procedural_scene(folder / "scene", arrangement="island", size=SIZE, views=VIEWS, subpixels=2)
        config = dataclasses.replace(PRESETS["quick"], steps=steps)
        run = train(scene, folder / "run", config)
        pack = with_pictures(bake(run, BakeConfig(resolution=resolution)), run.scene, COPIES)
        # The files of the photographs do not travel with the demo, only their copies: say what they were, not where.
        provenance = {**pack.metadata["provenance"], "scene": "tools.procedural", "run": "tools.demo"}
        out.parent.mkdir(parents=True, exist_ok=True)
        save_pack(pack.with_metadata(provenance=provenance), out, codec="webp")
        print(describe_pack(pack, out))
    finally:
        if work is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(run_command(demo, prog="python -m tools.demo", description="Makes the bundled demo pack again."))
