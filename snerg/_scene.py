"""Scene: a baked scene, its pictures and its surface; and showing it in a window or a notebook."""

from __future__ import annotations

import html
import importlib
import os
import sys
import threading
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex

from snerg._camera import Camera, camera_of, camera_of_view, check_choice, checked_fov, checked_size, view_of
from snerg._errors import SnergError, with_snerg_errors

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from scenepack.pack import Pack
    from viewer.rendering.offscreen import OffscreenRenderer

Mode = Literal["normal", "depth", "normals", "alpha", "features"]
MovedFrame = Literal["placed", "grid", "world"]
Codec = Literal["png", "webp", "jpeg", "h264", "avif"]
WHITE, FIRST_AZIMUTH = (1.0, 1.0, 1.0), 30.0  # degrees; where snerg-render, too, looks from


@with_snerg_errors
def load(path: str | Path, *, context: Any = None) -> Scene:
    """Opens a pack, a folder or one .zip, wholly in memory.

    Any number of scenes may be open. Each renders in an invisible OpenGL context of its own, or in `context`, a
    moderngl.Context of OpenGL 3.3 or later, which it leaves current as it was. Render a scene in one thread only. A process that
    was forked after the first picture cannot render.

    Raises:
        SnergError: Where there is no pack, or it cannot be read.
    """
    from scenepack.reader import load_pack

    if not (context is None or hasattr(context, "version_code")):
        expected = "a moderngl.Context, or None"
        raise SnergError("is no OpenGL context", where="context", expected=expected, found=type(context).__name__)
    return Scene(load_pack(Path(path)), Path(path), context)


@with_snerg_errors
def demo() -> Path:
    """Path of the small pack that comes with snerg.

    Raises:
        SnergError: Where this installation has none.
    """
    from viewer.core.files import demo_pack

    if not (found := demo_pack()).is_file():
        raise SnergError("this installation has no demo pack", remedy="install snerg again")
    return found


class Scene:
    """A baked scene, from `load` or `bake`. Close it, or use it in a `with` statement, to free the graphics card at once."""

    path: Path
    """Where it was read."""

    def __init__(self, pack: Any, path: Path, context: Any = None) -> None:
        """Private: `load` and `bake` make scenes."""
        self.path, self._context = path, context
        self._pack: Pack = pack
        self._renderer: OffscreenRenderer | None = None
        self._thread = (0, 0)  # that renders: its process and itself

    @property
    @with_snerg_errors
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras of the photographs that it was made from, in the frame "world"; none where the pack names none."""
        from viewer.features.photographs.photographs import shots_of

        return tuple(camera_of(shot.camera, shot.name, shot.split) for shot in shots_of(self._pack))

    @property
    @with_snerg_errors
    def metadata(self) -> dict[str, Any]:
        """What the pack says of itself, as JSON.

        `grid_size` (voxels x, y, z), `voxel_size` (length), `bounds` (corners of the content in the grid frame, [2, 3]),
        `forward_facing`, `world_T_grid` and `placed_T_grid` ([4, 4]), and, where the pack has them, `codec`, `version` and
        `provenance`.
        """
        from scenepack.placement import placed_T_grid
        from viewer.rendering.camera import content_box

        pack = self._pack
        return {
            "grid_size": list(pack.grid_size),
            "voxel_size": float(pack.voxel_size),
            "bounds": [corner.tolist() for corner in content_box(pack)],
            "forward_facing": pack.ndc,
            "world_T_grid": pack.worldspace_T_opengl.tolist(),
            "placed_T_grid": placed_T_grid(pack).tolist(),
            **{key: pack.metadata[key] for key in ("codec", "version", "provenance") if key in pack.metadata},
        }

    @with_snerg_errors
    def orbit(self, frames: int, *, fov: float = 39.0, size: tuple[int, int] = (800, 800)) -> list[Camera]:
        """One turn around the content, which fills the pictures; forward-facing scenes are flown along a small circle.

        `fov` is the vertical field of view in degrees, `size` width and height in pixels.

        Raises:
            SnergError: Where a number makes no sense.
        """
        from viewer.rendering.camera import filling_orbit

        size, fov = checked_size(size), checked_fov(fov)
        if not isinstance(frames, SupportsIndex) or index(frames) < 1:
            raise SnergError("is no number of pictures", where="frames", expected="1 or more", found=frames)
        return [camera_of_view(view) for view in filling_orbit(self._pack, frames, fov, size, FIRST_AZIMUTH)]

    @with_snerg_errors
    def render(
        self,
        camera: Camera | None = None,
        *,
        size: tuple[int, int] | None = None,
        mode: Mode = "normal",
        background: tuple[float, float, float] | None = WHITE,
        samples: int = 1,
    ) -> NDArray[Any]:
        """Renders one picture, without a window.

        Args:
            camera: By default the first of an `orbit`, which shows all of the content.
            size: Width and height in pixels. The default is the camera's, or 800 × 800.
            mode: What to render; see below.
            background: Colour behind everything in mode `normal`, sRGB in 0 ... 1; None leaves it out.
            samples: Rays along each side of a pixel, 1 ... 16: 4 averages 4 × 4 rays (anti-aliasing).

        Returns:
            An array whose first row is the upper one.

            - `normal`: the picture, uint8 [h, w, 3], sRGB; without background uint8 [h, w, 4], with straight alpha.
            - `depth`: float32 [h, w], distance along the optical axis in units of the scene; 0 where there is nothing.
            - `normals`: float32 [h, w, 3], unit vectors in the grid frame, away from the surface; 0 where there is nothing.
            - `alpha`: float32 [h, w], opacity in 0 ... 1.
            - `features`: float32 [h, w, 3], the first three features, accumulated along the ray.

        Raises:
            SnergError: Where there is no OpenGL, the scene does not fit on the graphics card, or a value makes no sense.
        """
        import numpy as np

        from viewer.rendering.layers import depth_along_axis, straight_rgba, unit_normals
        from viewer.rendering.opengl import current_context
        from viewer.rendering.settings import MOST_SAMPLES, RenderSettings

        check_choice("mode", mode, Mode)
        if samples not in range(1, MOST_SAMPLES + 1):
            raise SnergError("is out of range", where="samples", expected=f"1 to {MOST_SAMPLES}", found=samples)
        colour = _checked_colour(WHITE if background is None else background)
        if camera is None:
            camera = self.orbit(1, size=(800, 800) if size is None else size)[0]
        elif not isinstance(camera, Camera):
            remedy = "Camera.from_pose makes one of a matrix"
            raise SnergError("is no snerg.Camera", where="camera", found=type(camera).__name__, remedy=remedy)
        view = view_of(camera if size is None else camera.resized(*checked_size(size)), self._pack)
        raw = mode != "normal" or background is None
        settings = RenderSettings(mode=mode, background=colour, samples=int(samples), raw=raw)
        give_back = current_context()  # the caller may be drawing
        try:
            renderer = self._drawn_here()
            pixels = renderer.render_raw(view, settings) if raw else renderer.render(view, settings)
        finally:
            give_back()
        if mode == "depth":
            return depth_along_axis(pixels, view, renderer.pack)
        if mode == "normals":
            return unit_normals(pixels)
        if mode == "normal":
            return straight_rgba(pixels) if raw else pixels
        return np.ascontiguousarray(pixels[..., 3] if mode == "alpha" else pixels[..., :3])

    def _drawn_here(self) -> OffscreenRenderer:
        from viewer.rendering.offscreen import OffscreenRenderer

        global _rendering_process
        _rendering_process = _rendering_process or os.getpid()
        if _rendering_process != os.getpid():
            remedy = 'start processes by multiprocessing.get_context("spawn")'
            raise SnergError("OpenGL, once it has rendered, does not work in a forked process", remedy=remedy)
        if self._renderer is None:
            self._renderer, self._thread = OffscreenRenderer(self._pack, ctx=self._context), _this_thread()
        elif self._thread != _this_thread():
            raise SnergError("is rendered by another thread", where=self.path, remedy="load it in each thread")
        return self._renderer

    @with_snerg_errors
    def to_mesh(
        self, *, level: float = 0.15, faces: int | None = 500_000, smooth: int = 5, frame: MovedFrame = "placed"
    ) -> Geometry:
        """The surface as triangles with diffuse colours. Needs the extra `export`.

        `level` is the opacity at which the surface lies (0.004 ... 0.99), `faces` about the most triangles (None: all), `smooth`
        the steps of smoothing (Taubin). `frame` is "placed" (the grid frame, or as it was moved in the viewer, in its unit),
        "grid" or "world".

        Raises:
            SnergError: Where a value makes no sense, there is no surface, or the extra is missing.
        """
        return self._geometry("mesh", level=level, faces=faces or 0, smooth=smooth, frame=frame)

    @with_snerg_errors
    def to_points(self, *, level: float = 0.15, spacing: float = 1.0, frame: MovedFrame = "placed") -> Geometry:
        """Points on the surface, evenly by area, `spacing` voxels apart. Needs the extra `export`; see `to_mesh`.

        Raises:
            SnergError: As `to_mesh`.
        """
        return self._geometry("points", level=level, spacing=spacing, frame=frame)

    def _geometry(self, kind: Literal["mesh", "points"], **options: Any) -> Geometry:
        from scenepack.exports.scene import Export, geometry_of

        check_choice("frame", options["frame"], MovedFrame)
        made = geometry_of(self._pack, Export(kind, **options))
        return Geometry(made.vertices, made.normals, made.colours, made.faces, tuple(made.cameras))

    @with_snerg_errors
    def save(self, path: str | Path, *, codec: Codec = "png", title: str | None = None) -> None:
        """Writes a pack (a folder, or FILE.zip), or one web page that shows the scene (FILE.html).

        An older pack or page there is replaced. The codecs `png` and `webp` lose nothing; the others are smaller. `title` is the
        heading of a page, by default the name of the pack.

        Raises:
            SnergError: Where something else lies there, or it cannot be written.
        """
        from console import write_result
        from scenepack.exports.scene import SUFFIXES
        from scenepack.writer import save_pack

        if (suffix := Path(path).suffix.lower()) in (".html", ".htm"):
            write_result(Path(path), self._page(title))
        elif suffix in SUFFIXES:
            remedy = "to_mesh() and to_points() give what has a save() for it"
            raise SnergError(
                "is the name of no pack", where=path, expected="a folder, FILE.zip or FILE.html", remedy=remedy
            )
        else:
            save_pack(self._pack, Path(path), codec=codec)

    @with_snerg_errors
    def _page(self, title: str | None = None) -> bytes:
        from viewer.web.page import PageContent, scene_page

        return scene_page(self._pack, PageContent(title or self.path.resolve().stem))

    def close(self) -> None:
        """Frees what it holds on the graphics card. It may be rendered again."""
        renderer, self._renderer = self._renderer, None
        if renderer is not None and self._thread == _this_thread():
            from viewer.rendering.opengl import current_context

            give_back = current_context()
            renderer.release()
            give_back()

    def __enter__(self) -> Scene:
        """The scene, which the end of the `with` statement closes."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Closes it."""
        self.close()

    def __del__(self) -> None:
        """Closes it, unless the interpreter ends."""
        if getattr(self, "_renderer", None) is not None and not sys.is_finalizing():
            self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles are read again from where it lies, and render in a context of their own."""
        return load, (self.path.resolve(),)

    def __repr__(self) -> str:
        """Where it was read, and its size."""
        return f"Scene({str(self.path)!r}, {' × '.join(map(str, self._pack.grid_size))} voxels)"


_rendering_process = 0  # that made the first OpenGL context


def _this_thread() -> tuple[int, int]:
    return os.getpid(), threading.get_ident()


def _checked_colour(colour: Any) -> tuple[float, float, float]:
    try:
        red, green, blue = map(float, colour)
    except (TypeError, ValueError):
        red = green = blue = -1.0
    if not all(0.0 <= part <= 1.0 for part in (red, green, blue)):
        expected = "red, green and blue in 0 ... 1, or None"
        raise SnergError("is no colour", where="background", expected=expected, found=colour)
    return red, green, blue


@dataclass(frozen=True, eq=False)
class Geometry:
    """A mesh, or points, which have no faces."""

    vertices: NDArray[np.float32]
    """Positions, [n, 3]."""
    normals: NDArray[np.float32]
    """Unit vectors, [n, 3]."""
    colours: NDArray[np.uint8]
    """Diffuse colours, sRGB, [n, 3]."""
    faces: NDArray[np.int32]
    """Vertices of each triangle, [f, 3], counter-clockwise from outside."""
    _cameras: tuple[Any, ...] = field(default=(), repr=False)

    @with_snerg_errors
    def save(self, path: str | Path) -> None:
        """Writes FILE.ply, or FILE.glb (glTF 2.0; meshes alone, with the cameras of the photographs).

        Raises:
            SnergError: Where the suffix is another, or it cannot be written.
        """
        from console import write_result
        from scenepack.exports.scene import Geometry as Written

        suffixes = (".ply", ".glb") if len(self.faces) else (".ply",)
        if Path(path).suffix.lower() not in suffixes:
            raise SnergError("is not a supported file type", where=path, expected=" or ".join(suffixes))
        written = Written(self.vertices, self.normals, self.colours, self.faces, cameras=self._cameras)
        write_result(Path(path), written.file_parts(Path(path)))


# --- A window of its own, or a cell of a notebook ---

LARGEST_PAGE = 42 << 20  # bytes that a cell may hold; a notebook takes half as many again, in UTF-8


@with_snerg_errors
def show(scene: Scene, *, size: tuple[int, int] = (960, 600)) -> None:
    """Shows a scene to fly through.

    In a notebook, below the cell: the web page of the scene in a frame of `size` pixels, or a picture where the pack is too large
    for a page. Elsewhere the viewer's window, until it is closed.

    Raises:
        SnergError: Where there is no display, or the viewer fails.
    """
    size = checked_size(size)
    if _in_notebook():
        _display_in_cell(scene, size)
        return
    import subprocess

    from console.child_process import module_command
    from console.desktop import has_display

    if not has_display():
        raise SnergError("there is no display to show a window on", remedy="scene.render() gives pictures without one")

    words = ["--size", f"{size[0]}x{size[1]}"]
    done = subprocess.run(module_command("snerg", "view", str(scene.path.resolve()), *words), check=False)
    if done.returncode:
        raise SnergError("the viewer could not show it", where=scene.path, found=f"exit status {done.returncode}")


def _in_notebook() -> bool:
    """Whether this code runs in a cell of Jupyter."""
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell is not None and "IPKernelApp" in getattr(shell, "config", {})


def _display_in_cell(scene: Scene, size: tuple[int, int]) -> None:
    display = importlib.import_module("IPython.display")
    try:
        page = scene._page()
    except SnergError:
        page = b""
    if not 0 < len(page) <= LARGEST_PAGE:
        from PIL import Image

        display.display(Image.fromarray(scene.render(size=size)))
        return
    text = html.escape(page.decode("utf-16"))
    frame = f'<iframe srcdoc="{text}" width="{size[0]}" height="{size[1]}" style="border:0"></iframe>'
    display.display(display.HTML(frame))
