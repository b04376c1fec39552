"""Layout of the panels: docking, the rail, and the pages.

Notation: a node is a rectangle of the dock space that holds windows as tabs; the central node is left free for the
picture, and `home` is the node at the right where pages are shown unless they were dragged elsewhere. The layout is one
text: a line with the number of the home node, then what Dear ImGui writes into its .ini files.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core.input import shown_keys
from viewer.core.widgets import Box, Entry, coloured, more_button, px, style
from viewer.features.bookmarks import panel as bookmarks_panel
from viewer.features.camera import panel as camera_panel
from viewer.features.comparison import panel as comparison_panel
from viewer.features.crop import panel as crop_panel
from viewer.features.display import panel as display_panel
from viewer.features.editing import panel as editing_panel
from viewer.features.film import panel as film_panel
from viewer.features.measuring import panel as measuring_panel
from viewer.features.performance import panel as performance_panel
from viewer.features.photographs import panel as photographs_panel
from viewer.features.placing import panel as placing_panel
from viewer.features.preferences import panel as preferences_panel
from viewer.rendering.canvas import Canvas

HOST, SPACE = "##dock", "##space"
HEADER = "snerg layout, home "
LONGEST_TEXT = 65536  # what a page or two a window could ever need, and more
kinds = imgui.WindowFlags_
FIXED = kinds.no_decoration | kinds.no_move | kinds.no_saved_settings | kinds.no_nav | kinds.no_docking
FIXED |= kinds.no_bring_to_front_on_focus


class Docking:
    """The dock space of one imgui context, for all pages."""

    def __init__(self) -> None:
        self.names = {page.id: page.window for page in PAGES}  # of windows that may be docked, by page
        self.home = 0
        self._at_home = set(self.names)  # pages that belong home, be they shown or not

    def restore(self, text: str) -> None:
        """Takes over a layout that was remembered; call before the first frame. What is no layout is left out."""
        header, _, ini = text.partition("\n")
        number = header.removeprefix(HEADER)
        if header.startswith(HEADER) and number.isascii() and number.isdigit() and len(text) <= LONGEST_TEXT:
            imgui.load_ini_settings_from_memory(ini)
            self.home = int(number)

    def rescale(self, factor: float) -> None:
        """All that is in the pages has become so many times larger: the home node follows. The picture keeps half."""
        node = imgui.internal.dock_builder_get_node(self.home) if self.home else None
        if node is not None:
            width = min(node.size.x * factor, 0.5 * imgui.get_io().display_size.x)
            imgui.internal.dock_builder_set_node_size(self.home, ImVec2(width, node.size.y))

    @property
    def text(self) -> str:
        return f"{HEADER}{self.home}\n{imgui.save_ini_settings_to_memory()}"

    def space(self, app: App, box: Box, shown: bool) -> Box:
        """Lays the dock space into `box`; what is left of it for the picture. shown: False only keeps it in mind."""
        # Only a dock space that is shown has a hole over the picture; else its window would keep the mouse from all below.
        deaf = 0 if shown else imgui.WindowFlags_.no_mouse_inputs
        begin(HOST, box, (0, 0), imgui.WindowFlags_.no_background | deaf)
        space = imgui.get_id(SPACE)
        if shown:
            self._prepare(app, space, box)
        nodes = imgui.DockNodeFlags_
        flags = nodes.passthru_central_node | nodes.no_docking_over_central_node
        with coloured(docking_empty_bg=theme.BASE):
            imgui.dock_space(space, ImVec2(0, 0), flags if shown else nodes.keep_alive_only)
        imgui.end()
        if not shown:
            return box
        node = imgui.internal.dock_builder_get_central_node(space)
        return node.pos.x, node.pos.y, max(1.0, node.size.x), max(1.0, node.size.y)

    def _prepare(self, app: App, space: int, box: Box) -> None:
        """Makes the dock space, and the home node where a page is to be shown there."""
        builder = imgui.internal
        if not app.interface.layout_reset:  # until it is done, pages are still where they were dragged
            self._notice_moves(app)
        root = builder.dock_builder_get_node(space)
        sized = root is not None and root.size.x > 1 and root.size.y > 1  # it has none while the start page is shown
        if app.interface.layout_reset or root is None or (not sized and not self.home):
            root = self._begin_anew(space, box)
            app.interface.layout_reset = False
        if self.home and builder.dock_builder_get_node(self.home) is None:  # its last page was dragged away
            for page in self._at_home:  # those not shown went to the node's neighbour, which may be the picture
                builder.dock_builder_dock_window(self.names[page], 0)
            self.home = 0
        if self.home == 0 and app.interface.page:
            central = builder.dock_builder_get_central_node(space)
            if central is None:  # not laid out yet
                central = self._begin_anew(space, box) if root.is_split_node() else root
            share = min(px(SIDE) / max(central.size.x, 1.0), 0.8)
            self.home = builder.dock_builder_split_node(central.id_, imgui.Dir.right, share).id_at_dir
            for page in self._at_home - set(app.interface.moved):
                builder.dock_builder_dock_window(self.names[page], self.home)
            builder.dock_builder_finish(space)

    def _begin_anew(self, space: int, box: Box) -> imgui.internal.DockNode:
        builder = imgui.internal
        self.home, self._at_home = 0, set(self.names)
        builder.dock_builder_remove_node(space)
        builder.dock_builder_add_node(space, builder.DockNodeFlagsPrivate_.dock_space)
        builder.dock_builder_set_node_size(space, ImVec2(box[2], box[3]))
        return builder.dock_builder_get_node(space)

    def _notice_moves(self, app: App) -> None:
        """Tells the app which pages are not at home any more, or are there again."""
        for page, name in self.names.items():
            window = imgui.internal.find_window_by_name(name) if app.interface.shows(page) else None
            if window is not None and self.home:
                usual = window.dock_id == self.home
                self._at_home = self._at_home | {page} if usual else self._at_home - {page}
                app.interface.placed(page, usual)


# --- Rail and pages ---

TOP, RAIL, SIDE = 48.0, 50.0, 318.0
ICON_STEP = 40.0  # from one icon of the rail to the next
SMALLEST_PAGE = 250.0
NARROW = 620.0  # a window narrower than this has no space for a page beside the picture


@dataclass(frozen=True)
class Page:
    """One panel at the side. icon: Font Awesome. show: draws it."""

    id: str
    title: str
    icon: str
    show: Callable[[App, Canvas], None]

    @property
    def window(self) -> str:
        """Name of its window, as imgui and remembered layouts know it; what stands before ### may change."""
        return f"{self.icon}   {self.title}###page-{self.id}"


PAGES = (
    Page("view", "Picture", fa.ICON_FA_IMAGE, display_panel.show),
    Page("camera", "Camera", fa.ICON_FA_VIDEO, camera_panel.show),
    Page("bookmarks", "Bookmarks", fa.ICON_FA_BOOKMARK, bookmarks_panel.show),
    Page("crop", "Crop", fa.ICON_FA_CROP_SIMPLE, crop_panel.show),
    Page("erase", "Erase", fa.ICON_FA_ERASER, editing_panel.show),
    Page("measure", "Measure", fa.ICON_FA_RULER, measuring_panel.show),
    Page("move", "Move", fa.ICON_FA_UP_DOWN_LEFT_RIGHT, placing_panel.show),
    Page("photographs", "Photographs", fa.ICON_FA_IMAGES, photographs_panel.show),
    Page("compare", "Compare packs", fa.ICON_FA_CODE_COMPARE, comparison_panel.show),
    Page("film", "Stills and films", fa.ICON_FA_FILM, film_panel.show),
    Page("performance", "Performance", fa.ICON_FA_GAUGE_HIGH, performance_panel.show),
    Page("settings", "Settings", fa.ICON_FA_GEAR, preferences_panel.show),
    Page("log", "Log", fa.ICON_FA_LIST, preferences_panel.show_log),
)


@dataclass(frozen=True)
class Regions:
    """Boxes of the parts; width 0 where a part is not shown."""

    top: Box
    rail: Box
    dock: Box  # for the pages and the picture between them
    pages: bool  # whether there is space for pages beside the picture


def regions(width: float, height: float, app: App) -> Regions:
    """Divides a window of width × height units."""
    top = px(TOP) if app.interface.panels_shown else 0.0
    rail = px(RAIL) if app.interface.panels_shown and app.scene is not None else 0.0
    below = max(1.0, height - top)
    dock = (0.0, top, max(1.0, width - rail), below)
    pages = rail > 0 and width >= px(NARROW)
    return Regions((0.0, 0.0, width, top), (width - rail, top, rail, below), dock, pages)


def begin(name: str, box: Box, padding: tuple[float, float], extra: int = 0) -> None:
    """Begins a window that stays in its box; end it with imgui.end()."""
    imgui.set_next_window_pos(ImVec2(box[0], box[1]))
    imgui.set_next_window_size(ImVec2(box[2], box[3]))
    with style(window_rounding=0.0, window_padding=padding):
        imgui.begin(name, None, FIXED | extra)


def show_rail(app: App, where: Regions) -> None:
    """The icons that open and close pages; those that there is no space for are in a menu below them."""
    if where.rail[2] <= 0:
        return
    with coloured(window_bg=theme.BASE):
        begin("##rail", where.rail, (8, 10))
    interface = app.interface
    entries = [
        Entry(page.id, page.icon, page.title, partial(_turn, app, page.id, where.pages), on=_open(app, page.id, where))
        for page in PAGES
    ]
    if interface.moved:
        reset = partial(app.run, "layout")
        entries.append(Entry("layout", fa.ICON_FA_TABLE_COLUMNS, "Reset the layout", reset, shown_keys("Ctrl+L")))
    space = int((where.rail[3] - px(20) + px(8)) / px(ICON_STEP))
    shown = len(entries) if space >= len(entries) else max(space - 1, 0)
    for entry in entries[:shown]:
        entry.button()
    if shown < len(entries):
        more_button("rail more", entries[shown:])
    imgui.end()


def _open(app: App, page: str, where: Regions) -> bool:
    return app.interface.shows(page) if where.pages else app.interface.over == page


def _turn(app: App, page: str, docked: bool) -> None:
    """Opens or closes a page; over the picture where there is no space beside it."""
    interface = app.interface
    if not docked:
        interface.over = "" if interface.over == page else page
    elif interface.shows(page):
        interface.closes(page)
    else:
        interface.opens(page)


def show_pages(app: App, canvas: Canvas, where: Regions) -> None:
    """The pages that are open, wherever they are docked; in a narrow window one at most, over the picture."""
    if where.pages:
        app.interface.over = ""
    for page in PAGES:
        if where.rail[2] <= 0 or app.scene is None:  # closed in this frame, maybe
            return
        if _open(app, page.id, where):
            seen, still_open = _begin_docked(page) if where.pages else _begin_over(page, where)
            if seen:
                with coloured(child_bg=theme.CARD):
                    page.show(app, canvas)
            imgui.end()
            if not still_open:
                _turn(app, page.id, where.pages)


def _begin_over(page: Page, where: Regions) -> tuple[bool, bool | None]:
    """Begins a page over the picture; whether it is in view, and whether it was not closed just now."""
    _, y, width, height = where.dock
    wide = min(px(SIDE), width)
    imgui.set_next_window_pos(ImVec2(width - wide, y))
    imgui.set_next_window_size(ImVec2(wide, height))
    flags = kinds.no_move | kinds.no_resize | kinds.no_collapse | kinds.no_docking | kinds.no_saved_settings
    with style(window_padding=(12, 12), window_rounding=0.0):
        return imgui.begin(f"{page.icon}   {page.title}###over", True, flags)


def _begin_docked(page: Page) -> tuple[bool, bool | None]:
    """As _begin_over(), where the page is docked."""
    imgui.set_next_window_size(ImVec2(px(SIDE), px(520)), imgui.Cond_.first_use_ever)
    highest = max(px(160), 0.85 * imgui.get_io().display_size.y)  # of one that floats
    imgui.set_next_window_size_constraints(ImVec2(px(SMALLEST_PAGE), px(140)), ImVec2(1e6, highest))
    kind = imgui.WindowClass()
    kind.dock_node_flags_override_set = imgui.internal.DockNodeFlagsPrivate_.no_close_button  # tabs have one each
    imgui.set_next_window_class(kind)
    with style(window_padding=(12, 12)):
        return imgui.begin(page.window, True, imgui.WindowFlags_.no_collapse)
