"""Where pages are docked: Dear ImGui's dock space between the rail and the bar on top, the picture in its middle.

Notation: a node is a rectangle of the dock space that holds windows as tabs; the central node is left free for the
picture, and `home` is the node at the right where pages are shown unless they were dragged elsewhere. The layout is one
text: a line with the number of the home node, then what Dear ImGui writes into its .ini files.
"""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.panels import theme
from viewer.panels.widgets import coloured, px

Box = tuple[float, float, float, float]  # x, y, width, height in window units
HOST, SPACE = "##dock", "##space"
HEADER = "snerg layout, home "
LONGEST_TEXT = 65536  # what a page or two a window could ever need, and more
FIXED = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
    | imgui.WindowFlags_.no_nav
    | imgui.WindowFlags_.no_docking
)


class Docking:
    """The dock space of one imgui context. names: windows that may be docked, by page. width: of the home node, units."""

    def __init__(self, names: dict[str, str], width: float) -> None:
        self.names, self.width = names, width
        self.home = 0
        self._at_home = set(names)  # pages that belong home, be they shown or not

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
        """The layout, to be remembered."""
        return f"{HEADER}{self.home}\n{imgui.save_ini_settings_to_memory()}"

    def space(self, app: App, box: Box, shown: bool) -> Box:
        """Lays the dock space into `box`; what is left of it for the picture. shown: False only keeps it in mind."""
        imgui.set_next_window_pos(ImVec2(box[0], box[1]))
        imgui.set_next_window_size(ImVec2(box[2], box[3]))
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(0, 0))
        imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
        # Only a dock space that is shown has a hole over the picture; else its window would keep the mouse from all below.
        deaf = 0 if shown else imgui.WindowFlags_.no_mouse_inputs
        imgui.begin(HOST, None, FIXED | imgui.WindowFlags_.no_background | deaf)
        imgui.pop_style_var(2)
        space = imgui.get_id(SPACE)
        if shown:
            self._prepare(app, space, box)
        kinds = imgui.DockNodeFlags_
        flags = kinds.passthru_central_node | kinds.no_docking_over_central_node
        with coloured(docking_empty_bg=theme.BASE):
            imgui.dock_space(space, ImVec2(0, 0), flags if shown else kinds.keep_alive_only)
        imgui.end()
        if not shown:
            return box
        node = imgui.internal.dock_builder_get_central_node(space)
        return node.pos.x, node.pos.y, max(1.0, node.size.x), max(1.0, node.size.y)

    def _prepare(self, app: App, space: int, box: Box) -> None:
        """Makes the dock space, and the home node where a page is to be shown there."""
        builder = imgui.internal
        self._notice_moves(app)
        root = builder.dock_builder_get_node(space)
        sized = (
            root is not None and root.size.x > 1 and root.size.y > 1
        )  # while the start page is shown it gets no size
        if app.interface.layout_reset or root is None or (not sized and not self.home):
            root = self._begin_anew(space, box)
            app.interface.layout_reset = False
        if self.home and builder.dock_builder_get_node(self.home) is None:  # its last page was dragged away
            self._lose_home()
        if self.home == 0 and app.interface.page:
            central = builder.dock_builder_get_central_node(space)
            if central is None:  # not laid out yet
                central = self._begin_anew(space, box) if root.is_split_node() else root
            share = min(px(self.width) / max(central.size.x, 1.0), 0.8)
            self.home = builder.dock_builder_split_node(central.id_, imgui.Dir.right, share).id_at_dir
            for page in self._at_home - set(app.interface.moved):
                builder.dock_builder_dock_window(self.names[page], self.home)
            builder.dock_builder_finish(space)

    def _begin_anew(self, space: int, box: Box) -> imgui.internal.DockNode:
        """An empty dock space."""
        builder = imgui.internal
        self.home, self._at_home = 0, set(self.names)
        builder.dock_builder_remove_node(space)
        builder.dock_builder_add_node(space, builder.DockNodeFlagsPrivate_.dock_space)
        builder.dock_builder_set_node_size(space, ImVec2(box[2], box[3]))
        return builder.dock_builder_get_node(space)

    def _lose_home(self) -> None:
        """The node is gone, and imgui has sent the pages that are not shown to its neighbour, which may be the picture."""
        for page in self._at_home:
            imgui.internal.dock_builder_dock_window(self.names[page], 0)
        self.home = 0

    def _notice_moves(self, app: App) -> None:
        """Tells the app which pages are not at home any more, or are there again."""
        for page, name in self.names.items():
            window = imgui.internal.find_window_by_name(name) if app.interface.shows(page) else None
            if window is not None and self.home:
                usual = window.dock_id == self.home
                self._at_home = self._at_home | {page} if usual else self._at_home - {page}
                app.interface.placed(page, usual)
