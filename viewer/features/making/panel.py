"""Make dialog: how a scene is made of photographs or of a run."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core.theme import Fonts
from viewer.core.widgets import (
    begin_modal,
    cancel_or,
    confirmed,
    elided_start,
    font,
    hint,
    in_front,
    label,
    paragraph,
    px,
    segments,
    switch,
    tip,
    write,
)
from viewer.features.making import strips_panel, survey
from viewer.features.making.make_plan import RESOLUTIONS, Plan
from viewer.features.making.survey import OFFERED, result_lines
from viewer.rendering.canvas import Canvas

NAME, WIDTH, PADDING, LABELS = "##make", 560.0, 26.0, 122.0
AUTOMATIC = "Automatic"


def show(app: App, canvas: Canvas, size: ImVec2, fonts: Fonts) -> None:
    """Draws the question while there is one, and nothing is in front of it."""
    plan = app.making.plan
    if plan is None or in_front(app) != "make":
        return
    if not begin_modal(NAME, size, WIDTH, 0.47, padding=(PADDING, 22)):
        return
    _heading(plan, fonts)
    if plan.survey is not None and plan.survey.preview is not None:
        strips_panel.show_preview(canvas, plan.survey.preview)
    if plan.can_be_checked:
        _check(app, plan, fonts)
    imgui.dummy(ImVec2(0, px(6)))
    problem = plan.problem()
    surveying = plan.survey is not None and not plan.survey.finished
    if problem is None and not surveying:
        _choices(app, plan)
    if problem is not None:
        paragraph(problem, theme.WARN)
    if problem is None or plan.attempt is not None:
        _where(app, plan, remarks=problem is None)
    imgui.dummy(ImVec2(0, px(8)))
    _answer(app, plan, problem is None and plan.place_problem is None and not surveying)
    imgui.end_popup()


def _heading(plan: Plan, fonts: Fonts) -> None:
    with font(fonts.bold, theme.LARGE):
        write(fa.ICON_FA_WAND_MAGIC_SPARKLES, theme.ACCENT)
        imgui.same_line(0, px(12))
        verb = "Make" if plan.subject == "scene" else "Bake"
        imgui.text_unformatted(f"{verb} {plan.name} into a scene to fly through")
    survey = plan.survey
    if survey is None:
        paragraph("A training run. Baking turns it into voxels that are drawn in real time.", theme.MUTED)
    elif text := survey.text if survey.finished else "Reading the photographs…":
        paragraph(text, theme.MUTED)


def _check(app: App, plan: Plan, fonts: Fonts) -> None:
    """The row that checks the photographs: the button, how far the check is, or what it found."""
    check = app.making.check
    imgui.dummy(ImVec2(0, px(2)))
    if check is not None and check.running:
        if imgui.button("Stop##check", ImVec2(px(86), 0)):
            app.making.end_check()
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        report = check.report
        write("Starting the check…" if report is None else f"{report.title.capitalize()}, {report.share:.0%}")
        imgui.progress_bar(report.share if report is not None else 0.0, ImVec2(-1, px(6)), "")
        return
    assert plan.survey is not None
    imgui.begin_disabled(plan.survey.busy)
    if imgui.button(f"{fa.ICON_FA_MAGNIFYING_GLASS}  Check photographs", ImVec2(px(190), 0)):
        app.making.check_photographs(app)
    imgui.end_disabled()
    what = "Sharpness, overlap and exposure, and which photographs to take again"
    tip("Once the time is measured" if plan.survey.busy else what)
    if check is not None and check.error:
        hint(check.error, theme.WARN)
    elif check is not None and check.result is not None:
        imgui.same_line()
        if imgui.button(f"{fa.ICON_FA_ARROW_UP_RIGHT_FROM_SQUARE}  Open the page", ImVec2(px(150), 0)):
            check.open_page()
        tip(f"All photographs, and which of them match, in the browser: {check.page}")
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        write(f"Quality {check.result['score']:.0f} of 100", face=fonts.bold)
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(px(8), px(3)))
        for text, warns in result_lines(check.result):
            hint(text, theme.WARN if warns else theme.MUTED)
        imgui.pop_style_var()


def _choices(app: App, plan: Plan) -> None:
    """Preset, size and what else there is to choose; none of it where an earlier attempt is gone on with."""
    if plan.subject == "run":
        label("Voxels", LABELS)
        titles = {str(side): f"{side}³" for side in RESOLUTIONS}
        if picked := segments("voxels", list(titles), str(plan.resolution or RESOLUTIONS[1]), titles):
            plan.resolution = int(picked)
        _indented("More voxels show finer detail but take more memory and time. Baking 1000³ needs 5 GB.")
        return
    if plan.attempt is not None:
        return
    label("How", LABELS)
    picked = segments("preset", list(OFFERED), plan.preset, {name: preset.title for name, preset in OFFERED.items()})
    plan.preset = picked or plan.preset
    _indented(OFFERED[plan.preset].advice if plan.preset in OFFERED else plan.preset)
    survey = plan.survey
    assert survey is not None
    label("Photographs", LABELS)
    titles = {"": AUTOMATIC} | {str(k): f"{width} px" for k, (width, _) in survey.sizes.items()}
    picked = segments("downscale", ["", *map(str, survey.choices)], str(plan.downscale or ""), titles)
    if picked is not None:
        plan.downscale = int(picked) if picked else None
    size = survey.size(plan.preset, plan.downscale)
    _indented(f"Trained on {size[0]} × {size[1]} pixels each." if size else "")
    _indented(what_it_needs(plan, max(size)) if size else "")
    if survey.forward:
        label("360° capture", LABELS)
        plan.spherify = switch("spherify", plan.spherify)
    if plan.masked:
        label("Cut out", LABELS)
        plan.masks = switch("masks", plan.cut_out)
        tip("Keep only what the masks show")
    elif survey.masks:
        label("Cut out", LABELS)
        hint("Not possible: some photographs of this size have no mask.")


def what_it_needs(plan: Plan, side: int) -> str:
    """Time, memory and disk of making it, as far as they are known; side: pixels of the photographs' longer side."""
    estimate = plan.survey.time if plan.survey is not None else None
    disk = estimate.disk(plan.preset, side) if estimate is not None else None
    if estimate is None or disk is None:
        return ""
    needs = f"up to {survey.memory(plan.preset, side) / 1e9:.1f} GB of memory and {disk / 1e9:.1f} GB on the disk"
    seconds = estimate.seconds(plan.preset, side)
    if seconds is None:
        measuring = "Measuring how long it takes on this computer… " if not estimate.finished else ""
        return f"{measuring}It needs {needs}."
    return f"Takes about {strips_panel.roughly(seconds)} as measured on this computer, {needs}."


def _indented(text: str, colour: str = theme.FAINT) -> None:
    if text:
        imgui.indent(px(LABELS) - px(PADDING))
        hint(text, colour)
        imgui.unindent(px(LABELS) - px(PADDING))


def _where(app: App, plan: Plan, remarks: bool) -> None:
    imgui.dummy(ImVec2(0, px(2)))
    label("Where", LABELS)
    width = imgui.get_content_region_avail().x - px(92)
    imgui.text_unformatted(elided_start(str(plan.out), width - px(8)))
    tip(str(plan.out))
    imgui.same_line()
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(PADDING) - px(84))
    if imgui.button("Change…", ImVec2(px(84), 0)):
        app.making.ask_where(app)
    remark = plan.attempt_text()
    if not remark and plan.pack.exists():
        remark = "The folder has a pack. The new pack replaces it when it is complete."
    if remarks:
        _indented(plan.place_problem or remark, theme.WARN if plan.place_problem else theme.FAINT)


def _answer(app: App, plan: Plan, possible: bool) -> None:
    if imgui.button(f"{fa.ICON_FA_COPY}  Copy the command", ImVec2(px(176), px(34))):
        app.making.copy_command(app)
    tip("The same as a command line, for example for another computer")
    imgui.same_line()
    word = "Bake" if plan.subject == "run" else "Go on" if plan.attempt is not None else "Make it"
    cancelled, wanted = cancel_or(word, 112, PADDING, enabled=possible)
    wanted = wanted or (possible and confirmed())
    if cancelled or wanted:
        imgui.close_current_popup()
    if cancelled:
        app.making.dismiss()
    elif wanted:
        try:
            app.making.start(app)
        except Exception as error:  # nothing can be written there, say
            app.messages.fail("It cannot start", error)
