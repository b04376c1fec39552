"""Make dialog, and the cards of a scene that is being made: how far it is, and the review of its poses before the training."""

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from console.progress import duration
from console.progress_protocol import Report
from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.language import translated
from viewer.core.widgets import Box, px
from viewer.features.making.make_job import MakeJob, RejectedPhotographs, preview_title
from viewer.features.making.make_plan import RESOLUTIONS, Plan
from viewer.features.making.review import Kind, Review
from viewer.features.making.survey import LONGEST_SIDES, OFFERED, BarePreview, few_with_reasons, result_lines
from viewer.rendering.canvas import Canvas
from viewer.rendering.targets import Sheet

NAME, WIDTH, PADDING, LABELS = "##make", 560.0, 26.0, 122.0
WIDER = "Panoramas may be four times as wide."  # training.scenes.presets.bounded_side


def show(app: App, canvas: Canvas) -> None:
    """Draws the question while there is one, and nothing is in front of it."""
    plan = app.making.plan
    if plan is None or ui.in_front(app) != "make":
        return
    if not ui.begin_modal(NAME, WIDTH, 0.47, padding=(PADDING, 22)):
        return
    verb, survey = "Make" if plan.subject == "scene" else "Bake", plan.survey
    ui.heading(fa.ICON_FA_WAND_MAGIC_SPARKLES, f"{verb} {plan.name} into a scene to fly through")
    if survey is None:
        ui.paragraph("A training run. Baking turns it into voxels that are drawn in real time.", theme.MUTED)
    elif text := survey.text if survey.finished else "Reading the photographs…":
        ui.paragraph(text, theme.MUTED)
    if survey is not None and survey.preview is not None:
        show_preview(canvas, survey.preview)
    if plan.can_be_checked:
        _check(app, plan)
    imgui.dummy(ImVec2(0, px(6)))
    problem = plan.problem()
    surveying = survey is not None and not survey.finished
    if problem is None and not surveying:
        _choices(plan)
    if problem is not None:
        ui.paragraph(problem, theme.WARN)
    if problem is None or plan.attempt is not None:
        _where(app, plan, remarks=problem is None)
    imgui.dummy(ImVec2(0, px(8)))
    _answer(app, plan, problem is None and plan.place_problem is None and not surveying)
    imgui.end_popup()


def _check(app: App, plan: Plan) -> None:
    """The row that checks the photographs: the button, how far the check is, or what it found."""
    check = app.making.check
    imgui.dummy(ImVec2(0, px(2)))
    if check is not None and check.running:
        if ui.button("Stop##check", px(86)):
            app.making.end_check()
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        report = check.child.report
        so_far = f"{report.title.capitalize()}, {100 * report.share:.0f} %" if report else "Starting the check…"
        ui.write(so_far)
        imgui.progress_bar(report.share if report is not None else 0.0, ImVec2(-1, px(6)), "")
        return
    assert plan.survey is not None
    if ui.button(f"{fa.ICON_FA_MAGNIFYING_GLASS}  Check photographs", px(190), enabled=not plan.survey.busy):
        app.making.check_photographs(app)
    what = "Sharpness, overlap and exposure, and which photographs to take again"
    ui.tip("Once the time is measured" if plan.survey.busy else what)
    if check is not None and check.error:
        ui.hint(check.error, theme.WARN)
    elif check is not None and check.result is not None:
        imgui.same_line()
        if ui.button(f"{fa.ICON_FA_ARROW_UP_RIGHT_FROM_SQUARE}  Open the page", px(150)):
            check.open_page()
        ui.tip(f"All photographs, and which of them match, in the browser: {check.page}")
        if check.result["expected_psnr"] is not None:
            imgui.same_line()
            imgui.align_text_to_frame_padding()
            ui.write(f"About {check.result['expected_psnr']:.0f} dB", face=theme.fonts.bold)
            ui.tip("PSNR to be expected of photographs that are held out, after “Quick”; more is better")
        with ui.style(item_spacing=(8, 3)):
            for text, warns in result_lines(check.result):
                ui.hint(text, theme.WARN if warns else theme.MUTED)


def _choices(plan: Plan) -> None:
    """Preset, size and what else there is to choose; none of it where an earlier attempt is gone on with."""
    if plan.subject == "run":
        titles = {side: f"{side}³" for side in RESOLUTIONS}
        plan.resolution = ui.segments("Voxels", titles, plan.resolution or RESOLUTIONS[1], LABELS) or plan.resolution
        _indented("More voxels show finer detail but take more memory and time. Baking 1000³ needs 5 GB.")
        return
    if plan.attempt is not None:
        return
    presets = {name: preset.title for name, preset in OFFERED.items()}
    plan.preset = ui.segments("How", presets, plan.preset, LABELS) or plan.preset
    survey = plan.survey
    assert survey is not None
    advice = OFFERED[plan.preset].advice if plan.preset in OFFERED else plan.preset
    _indented(f"{advice} {WIDER}" if survey.panoramas and plan.preset in LONGEST_SIDES else advice)
    titles = {0: "Automatic"} | {k: f"{max(survey.sizes[k])} px" for k in survey.choices}
    picked = ui.segments("Photographs", titles, plan.downscale or 0, LABELS)
    if picked is not None:
        plan.downscale = picked or None
    size = survey.size(plan.preset, plan.downscale)
    _indented(f"Trained on {size[0]} × {size[1]} pixels each." if size else "")
    _indented(what_it_needs(plan, max(size)) if size else "")
    if survey.posed and survey.kind != "blender":
        anew = ui.switch("anew", survey.anew, "New poses")
        ui.tip("Find the camera poses again. Poses that a phone recorded may be wrong by several pixels.")
        if anew != survey.anew:
            plan.find_anew(anew)
    if survey.forward:
        plan.spherify = ui.switch("spherify", plan.spherify, "360° capture")
    if plan.masked:
        plan.masks = ui.switch("masks", plan.cut_out, "Cut out")
        ui.tip("Keep only what the masks show")
    elif survey.masks:
        ui.label("Cut out", LABELS)
        ui.hint("Not possible: some photographs of this size have no mask.")


def what_it_needs(plan: Plan, side: int) -> str:
    """Time, memory and disk of making it, as far as they are known; side: pixels of the photographs' longer side."""
    estimate = plan.survey.time if plan.survey is not None else None
    disk = estimate.disk(plan.preset, side) if estimate is not None else None
    if estimate is None or disk is None:
        return ""
    needs = f"up to {estimate.memory(plan.preset, side) / 1e9:.1f} GB of memory and {disk / 1e9:.1f} GB on the disk"
    seconds = estimate.seconds(plan.preset, side)
    if seconds is None:
        measuring = "Measuring how long it takes on this computer… " if not estimate.finished else ""
        return f"{measuring}It needs {needs}."
    return f"Takes about {roughly(seconds)} as measured on this computer, {needs}."


def _indented(text: str, colour: str = theme.FAINT) -> None:
    if text:
        imgui.indent(px(LABELS) - px(PADDING))
        ui.hint(text, colour)
        imgui.unindent(px(LABELS) - px(PADDING))


def _where(app: App, plan: Plan, remarks: bool) -> None:
    imgui.dummy(ImVec2(0, px(2)))
    ui.label("Where", LABELS)
    width = imgui.get_content_region_avail().x - px(92)
    imgui.text_unformatted(ui.elided_start(str(plan.out), width - px(8)))
    ui.tip(str(plan.out))
    imgui.same_line()
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(PADDING) - px(84))
    if ui.button("Change…", px(84)):
        app.making.ask_where(app, plan)
    remark = plan.attempt_text()
    if not remark and plan.pack.exists():
        remark = "The folder has a pack. The new pack replaces it when it is complete."
    if remarks:
        _indented(plan.place_problem or remark, theme.WARN if plan.place_problem else theme.FAINT)


def _answer(app: App, plan: Plan, possible: bool) -> None:
    if ui.button(f"{fa.ICON_FA_COPY}  Copy the command", px(176), px(34)):
        app.copy(plan.typed(), "The command is on the clipboard")
    ui.tip("The same as a command line, for example for another computer")
    imgui.same_line()
    word = "Bake" if plan.subject == "run" else "Go on" if plan.attempt is not None else "Make it"
    cancelled, wanted = ui.cancel_or(word, 112, PADDING, enabled=possible)
    wanted = wanted or (possible and ui.confirmed())
    if cancelled or wanted:
        imgui.close_current_popup()
    if cancelled:
        app.making.dismiss()
    elif wanted:
        with app.messages.as_dialog("It cannot start"):  # nothing can be written there, say
            app.making.start(app)


# --- Strips of small pictures: photographs before a scene is made of them, and rejected ones ---

Picture = tuple[int, str, bool]  # its index on the sheet, its tooltip, whether it is crossed out
HEIGHT, GAP, ROUNDING, BAR = 64.0, 5.0, 4.0, 12.0
FADED = 0.28  # of the opacity, of a picture that is set aside


def show_preview(canvas: Canvas, preview: BarePreview) -> None:
    """Draws the strip, and under it what is known."""
    imgui.dummy(ImVec2(0, px(2)))
    pictures, aside = [], preview.aside or {}
    for index in list(preview.boxes):
        name = preview.names[index] if index < len(preview.names) else ""
        why = aside.get(name)
        pictures.append((index, f"{name}\nset aside: {why}" if why else name, bool(why)))
    _strip("##strip", canvas.sheet(preview), preview, HEIGHT, pictures)
    if aside:
        ui.hint(f"{preview.used} of {preview.count} are used. Set aside: {few_with_reasons(aside)}.", theme.WARN)
    elif preview.used is not None:
        ui.hint(f"{preview.used} {'frames at most' if preview.of_film else 'photographs'} are used.")
    elif preview.count is not None:
        ui.hint(f"Looking at the pictures: {len(preview.names)} of {preview.count}")
    if preview.seconds is not None:
        taken = roughly(sum(preview.seconds.values()))
        ui.hint(f"Finding camera poses takes about {taken}, as measured on this computer.")
    elif not preview.finished and preview.aside is not None:
        ui.hint("Measuring how long it takes to find the camera poses…")


def _strip(name: str, texture: int, sheet: Sheet, height: float, pictures: list[Picture]) -> None:
    """A row of pictures that scrolls sideways."""
    flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_background
    imgui.begin_child(name, ImVec2(0, px(height + BAR)), 0, flags)
    wheel = imgui.get_io().mouse_wheel
    if wheel and imgui.is_window_hovered():
        imgui.set_scroll_x(imgui.get_scroll_x() - px(60) * wheel)
    for index, tooltip, crossed in pictures:
        _, _, width, tall = sheet.boxes[index]
        at, wide, high = imgui.get_cursor_screen_pos(), px(height) * width / tall, px(height)
        low, opacity = ImVec2(at.x + wide, at.y + high), FADED if crossed else 1.0
        ui.draw_picture(texture, at, low, sheet.uv(index) or ui.WHOLE, opacity=opacity, rounding=ROUNDING)
        if crossed:
            _cross(at, low)
        imgui.dummy(ImVec2(wide, high))
        if imgui.is_item_hovered():
            imgui.set_tooltip(tooltip)
        imgui.same_line(0, px(GAP))
    imgui.end_child()


def _cross(at: ImVec2, low: ImVec2) -> None:
    draw = imgui.get_window_draw_list()
    x, y, arm = 0.5 * (at.x + low.x), 0.5 * (at.y + low.y), px(7)
    for rise in (arm, -arm):
        draw.add_line(ImVec2(x + arm, y + rise), ImVec2(x - arm, y - rise), theme.packed(theme.WARN), px(2.5))
    draw.add_rect(at, low, theme.packed(theme.WARN, 0.8), px(ROUNDING), px(1.2))


def roughly(seconds: float) -> str:
    """An estimate without digits that it does not have: "20 s", "4 min"."""
    step = 10 if seconds < 90 else 60 if seconds < 3600 else 600
    return duration(max(round(seconds / step), 1) * step).removesuffix(" 00 s")


def show_rejected(app: App, canvas: Canvas, rejected: RejectedPhotographs) -> None:
    """A line that counts and names photographs that are left out, and a row of them, with the reason where the mouse rests."""
    names = list(rejected.why)
    count = "1 photograph is left out" if len(names) == 1 else f"{len(names)} photographs are left out"
    ui.hint(f"{count}: {few_with_reasons(rejected.why)}.", theme.WARN)
    if not rejected.finished:
        app.touch(2)
    elif rejected.boxes:
        pictures = [(i, f"{names[i]}\n{translated(rejected.why[names[i]])}", False) for i in rejected.boxes]
        _strip("##left out", canvas.image("left out", rejected.sheet), rejected, 52.0, pictures)


# --- How far it is ---

PICTURE = "making"
MOST_WARNINGS, LONGEST_WARNING = 3, 200  # characters


def show_job(app: App, canvas: Canvas, box: Box) -> None:
    """The card of what is being made, at the lower left of the viewport's box."""
    making, job = app.making, app.making.job
    if job is None:
        canvas.drop_image(PICTURE)
        return
    with ui.corner_card("##job", box):
        note = f"{job.figures[-1]:.1f} dB" if job.figures else ""
        stopping = job.child.stopping
        if ui.titled_button(job.plan.name, "Stop now" if stopping else "Stop", note):
            making.stop()
        ui.tip("Stop without saving" if stopping else "Finished work is kept. Make the scene again to continue.")
        if making.sparse_preview is not None and not making.sparse_preview_shown(app):
            if ui.button(f"{fa.ICON_FA_EYE}  Show the points and cameras", height=px(28)):
                making.show_points(app)
            ui.tip("The scene that is open now is closed")
        if job.preview is not None:
            name = preview_title(job.preview)
            if making.training_preview_shown(app):
                ui.hint(f"You see a {name}. It is small and coarse; a newer one takes its place by itself.")
            else:
                if ui.button(f"{fa.ICON_FA_EYE}  Show the {name}", height=px(28)):
                    making.show_training_preview(app)
                ui.tip("Fly around in what is trained so far")
        if job.picture is not None:  # a held-out photograph beside how it is rendered so far
            height, width = job.picture.shape[:2]
            at, wide = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
            low = ImVec2(at.x + wide, at.y + wide * height / width)
            ui.draw_picture(canvas.image(PICTURE, job.picture), at, low, rounding=6)
            imgui.dummy(ImVec2(wide, wide * height / width))
        if len(job.figures) > 2:
            _curve(job)
        _stages(job)
        report = job.child.report
        imgui.progress_bar(report.share if report is not None else 0.0, ImVec2(-1, px(6)), "")
        ui.hint(_status_text(job))
        for warning in job.warnings[-MOST_WARNINGS:]:
            text = warning.removeprefix(f"{job.plan.source}: ")
            ui.hint(text if len(text) <= LONGEST_WARNING else f"{text[:LONGEST_WARNING]}…", theme.WARN)
            ui.tip(text)


def _curve(job: MakeJob) -> None:
    """PSNR since the window began to watch."""
    wide, high = imgui.get_content_region_avail().x, px(34)
    at = imgui.get_cursor_screen_pos()
    imgui.dummy(ImVec2(wide, high))
    low, top = min(job.figures), max(job.figures)
    span, count = max(top - low, 0.5), len(job.figures) - 1
    points: list[imgui.ImVec2Like] = [
        ImVec2(at.x + wide * i / count, at.y + high - px(2) - (value - low) / span * (high - px(4)))
        for i, value in enumerate(job.figures)
    ]
    imgui.get_window_draw_list().add_polyline(points, theme.packed(theme.ACCENT), px(1.6), 0)


def _stages(job: MakeJob) -> None:
    for i, name in enumerate(job.plan.stages, 1):
        if i > 1:
            imgui.same_line(0, px(8))
            ui.write(fa.ICON_FA_CHEVRON_RIGHT, theme.FAINT)
            imgui.same_line(0, px(8))
        trained = job.plan.subject == "run" and i == 1
        if trained or job.stage > i:
            ui.write(f"{fa.ICON_FA_CHECK}  {'Trained' if trained else name}", theme.GOOD)
        else:
            ui.write(name, theme.TEXT if job.stage == i else theme.FAINT)


def _status_text(job: MakeJob) -> str:
    if job.child.stopping:
        training = job.plan.stages[max(job.stage, 1) - 1] == "Training"
        return "Ending…" if job.child.killed else f"Stopping{': saving a checkpoint' if training else ''}…"
    report = job.child.report
    if report is None:
        return f"Starting: reading the photographs{'' if job.plan.bare else ' and compiling'}…"
    if report.stage == "training":
        return with_time_left(f"Step {report.done:,.0f} of {report.total:,.0f}", report)
    return with_time_left(f"{report.title[:1].upper()}{report.title[1:]}, {100 * report.share:.0f} %", report)


def with_time_left(text: str, report: Report) -> str:
    """A line of how far something is, with the time that is left where that is known."""
    if report.seconds_left is None or report.share >= 1:
        return text
    return f"{text}   ·   {duration(report.seconds_left)} left"


# --- Review of the poses ---

REVIEW_LABELS = 86.0
KINDS: dict[Kind, tuple[str, str]] = {
    "subject": ("Subject", "The cameras look inwards at something. The box keeps to it."),
    "room": ("Room", "The cameras look outwards. The box reaches to the walls."),
    "forward": ("Forward", "The cameras look one way. All that they see is trained; there is no box."),
}


def show_review(app: App, canvas: Canvas, box: Box) -> None:
    """Draws the card at the lower left of the viewport's box, while there is something to review."""
    review = app.making.review
    if review is None:
        return
    sparse = review.sparse_preview
    with ui.corner_card("##review", box):
        ui.heading(fa.ICON_FA_CHECK, review.plan.name, theme.GOOD, 16.0)
        count = sum(map(len, sparse.scene.splits.values()))
        ui.hint(f"{count} photographs have a camera pose, with {len(sparse.points.places):,} points.", theme.MUTED)
        if review.rejected is not None:
            show_rejected(app, canvas, review.rejected)
        shown = app.making.sparse_preview_shown(app)
        if not shown:
            if ui.button(f"{fa.ICON_FA_EYE}  Show the points", height=px(30)):
                review.hold()
                app.making.show_points(app)
            ui.tip("The scene that is open now is closed")
        _review_choices(app, review, shown)
        imgui.dummy(ImVec2(0, px(2)))
        half = ui.half_width()
        if ui.button("Not now", half, px(34)):
            app.making.leave(app)
        ui.tip("The camera poses are kept. Make the scene again to continue.")
        imgui.same_line(0, px(8))
        left = review.seconds_left
        if ui.main_button("Train it" if left is None else f"Train it ({left} s)", half):
            app.making.train(app)
        ui.tip("Training begins by itself if nothing is touched" if left is not None else "Training begins")


def _review_choices(app: App, review: Review, shown: bool) -> None:
    kinds: dict[Kind, tuple[str, str]] = {kind: KINDS[kind] for kind in review.kinds}
    kind = ui.explained("Seen as", kinds, review.kind, REVIEW_LABELS)
    if kind != review.kind:
        app.making.choose_kind(app, kind)
        if app.settings.crop is not None:
            app.interface.opens("crop")  # where the box is drawn
    if review.kind == "forward" or not shown:
        return
    _upright(app, review)
    on = ui.switch("box", app.settings.crop is not None, "Box")
    ui.tip("Show the box that is trained, and drag its faces")
    if on != (app.settings.crop is not None):
        review.show_box(app, on)
        if on:
            app.interface.opens("crop")
    usage = "Drag the dots on its faces, or type numbers on the Crop page."
    ui.hint(usage if on else "Switch it on to see and change it.")


def _upright(app: App, review: Review) -> None:
    """What is up: the cameras' own, or the ground's, which is clicked on."""
    picking = ui.switch("up", review.picking, "Up")
    if picking != review.picking:
        review.hold()
        review.picking = picking
    ui.tip("Click on the ground in the picture, and it becomes level")
    if review.picking:
        ui.hint("Click on points of the ground.")
    elif review.plan.up is None:
        ui.hint("From the cameras. Switch it on and click on the ground.")
    else:
        ui.hint("Set by you.")
        imgui.same_line(0, px(12))
        if imgui.small_button("As it was"):
            app.making.set_up(app, None)
        ui.tip("The mean up direction of the cameras")
