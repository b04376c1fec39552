"""snerg-view in which a scene is being made by the real snerg-make; it closes once that has ended.

python -m tools.fuzz.making_window SCENE OUT STEPS RESOLUTION. Exit status 2 where snerg-make says why there
is no pack then, 1 where it does not.
"""

import sys
from pathlib import Path

from viewer.app.application import App
from viewer.commands import view
from viewer.features.making.make_plan import Plan


def main(scene: Path, out: Path, steps: int, resolution: int) -> int:
    start = view.apply_preferences
    plan = Plan("scene", scene, out, preset="tiny", steps=steps, resolution=resolution)

    def use(app: App, preferences) -> None:
        start(app, preferences)
        app.making.plan = plan
        app.making.start(app)
        app.making.quit_after = True

    view.apply_preferences = use
    status = view.main([])
    if status == 0 and not (out / "pack").is_dir():
        said = plan.log.read_text().splitlines() if plan.log.exists() else []
        why = [line for line in said if line.startswith("snerg-make: ") and ": warning: " not in line]
        print(*(why or said or ["nothing was begun"]), sep="\n", file=sys.stderr)
        return 2 if why else 1
    return status


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
