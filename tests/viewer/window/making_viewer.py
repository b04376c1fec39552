"""snerg-view in which something is being made already: python making_viewer.py FOLDER, for tests.viewer.app.fake_make."""

import sys
from pathlib import Path

from viewer.app.make_plan import Plan
from viewer.commands import view

FAKE = Path(__file__).parents[1] / "app" / "fake_make.py"


def main(folder: Path) -> int:
    Plan.command = lambda plan: [sys.executable, str(FAKE), "wait", str(folder)]
    start = view.apply_preferences

    def use(app, preferences) -> None:
        start(app, preferences)
        app.making.plan = Plan("scene", folder / "photographs", folder)
        app.making.start(app)

    view.apply_preferences = use
    return view.main([])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
