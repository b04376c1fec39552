"""snerg from Python: open baked scenes, render them into NumPy arrays, and make scenes from photographs.

    import snerg

    scene = snerg.load(snerg.demo())
    picture = scene.render(size=(800, 600))  # uint8 [600, 800, 3]

The names in `__all__` are public. Modules that begin with an underscore, and all other packages of this installation, are
private: they change without notice.

Frames. `grid`: the pack's own frame, y up. `world`: the training frame, in which the
photographs' poses are. Both are right-handed (but `grid` of forward-facing scenes, which mirrors z) and have the scene's own unit
of length. Cameras have OpenGL axes: x right, y up, z back. Pixel (x, y) is seen through (x + 0.5, y + 0.5), y down.

Whatever a user can correct raises `SnergError`. Importing snerg loads neither JAX nor OpenGL; the functions that need them do.
"""

from snerg._camera import Camera
from snerg._errors import SnergError
from snerg._making import Photographs, Progress, Run, Scores, ViewScores, bake, evaluate, read_photographs, train
from snerg._scene import Geometry, Scene, demo, load, show

__all__ = [
    "Camera",
    "Geometry",
    "Photographs",
    "Progress",
    "Run",
    "Scene",
    "Scores",
    "SnergError",
    "ViewScores",
    "bake",
    "demo",
    "evaluate",
    "load",
    "read_photographs",
    "show",
    "train",
]
