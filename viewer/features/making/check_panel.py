"""Row of the make dialog that checks the photographs, and shows what was found."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core.theme import Fonts
from viewer.core.widgets import font, hint, px, tip
from viewer.features.making.make_plan import Plan
from viewer.features.making.photograph_check import PhotographCheck, result_lines

BUTTON = 190.0


def show(app: App, plan: Plan, fonts: Fonts) -> None:
    """Draws the button, how far the check is, or what it found."""
    check = app.making.check
    imgui.dummy(ImVec2(0, px(2)))
    if check is not None and check.running:
        _progress(app, check)
        return
    assert plan.survey is not None
    imgui.begin_disabled(plan.survey.busy)
    if imgui.button(f"{fa.ICON_FA_MAGNIFYING_GLASS}  Check photographs", ImVec2(px(BUTTON), 0)):
        app.making.check_photographs(app)
    imgui.end_disabled()
    tip(
        "Once the time is measured"
        if plan.survey.busy
        else "Sharpness, overlap and exposure, and which photographs to take again"
    )
    if check is None:
        return
    if check.error:
        hint(check.error, theme.WARN)
    elif check.result is not None:
        imgui.same_line()
        if imgui.button(f"{fa.ICON_FA_ARROW_UP_RIGHT_FROM_SQUARE}  Open the page", ImVec2(px(150), 0)):
            check.open_page()
        tip(f"All photographs, and which of them match, in the browser: {check.page}")
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        with font(fonts.bold, 0.0):
            imgui.text_unformatted(f"Quality {check.result['score']:.0f} of 100")
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(px(8), px(3)))
        for text, warns in result_lines(check.result):
            hint(text, theme.WARN if warns else theme.MUTED)
        imgui.pop_style_var()


def _progress(app: App, check: PhotographCheck) -> None:
    report = check.report
    if imgui.button("Stop##check", ImVec2(px(86), 0)):
        app.making.stop_check(app)
    imgui.same_line()
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted(
        "Starting the check…" if report is None else f"{report.title.capitalize()}, {report.share:.0%}"
    )
    imgui.progress_bar(report.share if report is not None else 0.0, ImVec2(-1, px(6)), "")
