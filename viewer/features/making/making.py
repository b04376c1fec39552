"""Making a scene from the window: the plan, the process that trains and bakes, the previews, and opening the pack.

One scene at a time. Stopping asks the process to save and to end, which may take minutes, because JAX first ends the steps that
have begun. It is killed only on request. The same plan resumes from what is saved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from console import UserError
from training.scenes.scene import Direction
from viewer.core.files import FileRequest, existing_folder
from viewer.core.log import Dialog
from viewer.core.tasks import CommandProcess, Task
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.making.make_job import MakeJob, preview_title, rejected_photographs_of
from viewer.features.making.make_plan import Plan, Subject
from viewer.features.making.review import Kind, Review, SparsePreview, read_sparse_preview
from viewer.features.making.survey import PhotographCheck, Survey

if TYPE_CHECKING:
    from viewer.app.application import App

AGAIN = (("OK", ""), ("Try again", "make-again"))  # buttons
PARTING_S = 30.0  # for the process to save, where the program ends and there is no window to wait in


class SparsePreviewJob(Task[SparsePreview | None]):
    """Reads the sparse points of a plan's scene. If the plan ends with poses, a review follows. before: the one it replaces."""

    def __init__(self, plan: Plan, before: Review | None = None) -> None:
        self.plan, self.before = plan, before
        super().__init__(partial(read_sparse_preview, plan.posed, plan.spherify, plan.cut_out, plan.up))


@dataclass
class Making:
    """State of the make-a-scene workflow."""

    plan: Plan | None = None  # shown in the dialog
    check: PhotographCheck | None = None  # of the plan's photographs
    job: MakeJob | None = None  # runs now
    failed: Plan | None = None  # the last plan that failed
    quit_after: bool = False  # whether the program ends once the job has stopped
    review: Review | None = None  # waits for the user before training
    reading: SparsePreviewJob | None = None  # reads the sparse points now
    sparse_preview: SparsePreview | None = None  # the points that were read
    _left_shown: int | None = None

    def offer(self, app: App, subject: Subject, path: Path) -> None:
        """Asks whether, and how, a scene or a run shall be made into a pack."""
        under_way = self.job or self.review or self.reading
        if under_way is not None:
            text = f"{under_way.plan.name} is still being made. Wait for it or stop it, then try again."
            app.messages.dialogs.append(Dialog("One scene at a time", text))
            return
        plan = Plan.of(subject, path)
        self.dismiss()
        self.plan = plan

    def again(self) -> None:
        if self.failed is not None and self.job is None:
            self.plan, self.failed = self.failed, None
            self.plan.choose(self.plan.out)

    @property
    def _survey(self) -> Survey | None:
        return None if self.plan is None else self.plan.survey

    @property
    def busy(self) -> bool:
        """Whether something goes on that tick should look at now and then."""
        waits = any(each is not None for each in (self.job, self.reading, self.review))
        checks = self.check is not None and self.check.running
        return waits or checks or (self._survey is not None and self._survey.busy)

    def dismiss(self) -> None:
        """Closes the question."""
        self.end_check()
        if self._survey is not None:
            self._survey.cancel()
        self.plan = None

    def ask_for_photographs(self, app: App) -> None:
        what = "A scene's photographs, or a training run"
        app.file_request = FileRequest(what, "folder", lambda path: app.drop([path]))

    def ask_where(self, app: App, plan: Plan) -> None:
        def then(path: Path) -> None:
            plan.choose(path / plan.out.name if path.is_dir() and any(path.iterdir()) else path)

        app.file_request = FileRequest("Where to save the scene", "folder", then, start=existing_folder(plan.out))

    def check_photographs(self, app: App) -> None:
        """Begins to check the plan's photographs, instead of what was found before."""
        if self.plan is not None and self.plan.can_be_checked:
            self.end_check()
            with app.messages.as_dialog("The photographs cannot be checked"):
                self.check = PhotographCheck.begin(self.plan.source, self.plan.out)

    def end_check(self) -> None:
        if self.check is not None:
            self.check.close()
        self.check = None

    def start(self, app: App) -> None:
        """Begins, with finding poses where there are none. UserError where that cannot be, with the question left open."""
        plan = self.plan
        if plan is None or plan.problem() is not None or plan.place_problem is not None:
            return
        plan.poses_only = plan.bare is not None and plan.attempt is None
        self._begin(app, plan)
        self.dismiss()
        self.review = self.sparse_preview = None
        has_points = plan.bare is not None or (plan.survey is not None and plan.survey.kind == "colmap")
        if has_points and not plan.poses_only:
            self.reading = SparsePreviewJob(plan)

    def _begin(self, app: App, plan: Plan) -> None:
        self.job = MakeJob(plan, CommandProcess(plan.command(), plan.log))
        app.messages.log(f"making {plan.name}: {plan.typed()}")
        app.touch()

    def train(self, app: App) -> None:
        """Goes on from the review, with what was chosen there."""
        review = self.review
        if review is None:
            return
        # The crop box of another scene, opened in the meantime, is none of ours.
        plan = review.decided(app.settings.crop if self.sparse_preview_shown(app) else None)
        self._uncut(app)
        self.review = None
        try:
            self._begin(app, plan)
        except UserError as error:
            self.failed = plan
            app.messages.fail(f"{plan.name} could not be made", error, AGAIN)

    def leave(self, app: App) -> None:
        """Nothing is trained now; the poses stay in their folder."""
        if self.review is not None:
            app.messages.say(f"The camera poses of {self.review.plan.name} are kept; make it again to continue")
            self._uncut(app)
        self.review = None

    def _uncut(self, app: App) -> None:
        if self.sparse_preview_shown(app):
            app.set(crop=None)

    def choose_kind(self, app: App, kind: Kind) -> None:
        """In the review: what the scene is taken for."""
        if self.review is not None and kind != self.review.kind:
            self.review.hold()
            self.review.kind = kind
            if self.sparse_preview_shown(app):
                app.set(crop=self.review.box_in_grid())

    def set_up(self, app: App, up: Direction | None) -> None:
        """In the review: another direction is up; None for the cameras' own. The points are read again."""
        if self.review is not None:
            self._uncut(app)
            self.reading = SparsePreviewJob(replace(self.review.plan, up=up), self.review)
            self.review = None

    def show_points(self, app: App) -> None:
        """Shows the points and cameras of what is being made, from outside, with their photographs."""
        under_way = self.review or self.job
        if self.sparse_preview is not None and under_way is not None:
            plan, sparse = under_way.plan, self.sparse_preview
            app.show(sparse.pack, plan.pack, f"{plan.name}: camera poses", stays=False).rig.begin_at(sparse.overview())
            app.gallery.frusta = True

    def sparse_preview_shown(self, app: App) -> bool:
        """Whether they are what is shown now."""
        return self.sparse_preview is not None and app.scene is not None and app.scene.pack is self.sparse_preview.pack

    def show_training_preview(self, app: App) -> None:
        """Shows what is trained so far; of what comes later, the newest, as long as this is shown."""
        if self.job is None or self.job.preview is None:
            return
        plan, preview, before = self.job.plan, self.job.preview, app.scene
        name = f"{plan.name}: {preview_title(preview)}"
        if before is not None and before.path == plan.preview_file and before.pack.ndc == preview.ndc:
            if app.filming.export is not None:
                return  # a film is of one scene; the next state may be shown
            app.refine(before, preview, dialog=False)
            before.name = name
            before.rig.follow(orbit_camera_for(preview))
        else:
            stand_there = self._kept_camera(app)
            app.show(preview, plan.preview_file, name, stays=False)
            stand_there()

    def training_preview_shown(self, app: App) -> bool:
        """Whether a state of what is being made is what is shown now."""
        return self.job is not None and app.scene is not None and app.scene.path == self.job.plan.preview_file

    def _offer_training_preview(self, app: App, job: MakeJob) -> None:
        first = not job.preview_offered and (app.scene is None or self.sparse_preview_shown(app))
        if first or self.training_preview_shown(app):
            job.preview_offered = True
            try:
                self.show_training_preview(app)
            except UserError as error:  # it does not fit on the GPU
                app.messages.log(f"the preview cannot be shown: {error}", "warning")
        app.touch()

    def _tick_look(self, app: App) -> None:
        reading, review = self.reading, self.review
        if reading is not None and reading.finished:
            self.reading = None
            self._take_sparse_preview(app, reading)
        elif review is not None and review.seconds_left == 0:
            self.train(app)
        elif review is not None and review.seconds_left != self._left_shown:
            self._left_shown = review.seconds_left
            app.touch(1)

    def _take_sparse_preview(self, app: App, reading: SparsePreviewJob) -> None:
        shown, self.sparse_preview = self.sparse_preview_shown(app), reading.result()
        if reading.plan.poses_only:
            if self.sparse_preview is None:  # too few points to see anything
                self._begin(app, replace(reading.plan, poses_only=False))
                return
            if (earlier := reading.before) is None:
                rejected = rejected_photographs_of(reading.plan.out)
                self.review = Review(reading.plan, self.sparse_preview, rejected)
            else:
                self.review = Review(reading.plan, self.sparse_preview, earlier.rejected, until=None)
                self.review.kind = earlier.kind if earlier.kind in self.review.kinds else self.review.kind
        if self.sparse_preview is not None and (app.scene is None or shown):
            self.show_points(app)
        app.touch()

    def _kept_camera(self, app: App) -> Callable[[], None]:
        """What puts the camera where it is now among the points, or in what is trained so far, once something better is shown."""
        passing = self.sparse_preview_shown(app) or self.training_preview_shown(app)
        rig = app.scene.rig if app.scene is not None and passing else None

        def then() -> None:
            # Asked only now, because the camera may move while the pack is read.
            if rig and app.scene and rig.goal != rig.home_pose and app.scene.rig.bounded == rig.bounded:
                app.scene.rig.stand_as(rig)

        return then

    def stop(self) -> None:
        """Asks the job to stop; asked again, ends it at once."""
        if self.job is not None:
            self.job.child.kill() if self.job.child.stopping else self.job.child.stop()

    def ask_to_quit(self, app: App) -> None:
        """Quits, but asks first where a scene is being made."""
        if self.job is None:
            app.quitting = True
            return
        title = f"{self.job.plan.name} is still being made"
        if not self.quit_after and all(dialog.title != title for dialog in app.messages.dialogs):
            text = "Quitting stops it. Finished work is kept. Make the scene again to continue."
            buttons = (("Keep going", ""), ("Stop and quit", "stop-and-quit"))
            app.messages.dialogs.append(Dialog(title, text, buttons=buttons))
        app.touch()

    def stop_and_quit(self, app: App) -> None:
        """Quits as soon as the job has stopped."""
        self.quit_after = True
        if self.job is None:
            app.quitting = True
        elif not self.job.child.stopping:
            self.stop()

    def end(self) -> None:
        """The program ends: no child outlives it."""
        self.dismiss()
        if self.job is not None:
            self.job.child.end(PARTING_S)
            self.job = None

    def tick(self, app: App) -> None:
        if self._survey is not None and self._survey.news():
            app.touch()
        self._tick_look(app)
        if (check := self.check) is not None:
            if check.poll():
                app.touch(2)
            if check.no_browser:
                check.no_browser = False
                app.messages.say(f"No browser was found. The page is {check.page}", "warning")
        if (job := self.job) is None:
            return
        shown = job.preview
        if job.poll():
            app.touch(2)
        if job.preview is not shown:
            self._offer_training_preview(app, job)
        if job.status is not None:
            kept, self.job = self._kept_camera(app), None
            app.touch()
            self._ended(app, job, kept)

    def _ended(self, app: App, job: MakeJob, kept: Callable[[], None]) -> None:
        name = job.plan.name
        if job.status == 0 and job.plan.poses_only:
            self.reading = SparsePreviewJob(job.plan)
        elif job.status == 0:
            app.messages.say(f"{name} is ready")
            app.open(job.plan.pack, then=kept)
        elif job.child.stopping:
            app.messages.say(f"{name} was stopped; make it again to continue")
        else:
            self.failed = job.plan
            rejected = rejected_photographs_of(job.plan.out) if job.plan.poses_only else None
            text = f"{job.child.error_line()}\n\nThe full log is in {job.plan.log}"
            app.messages.fail(f"{name} could not be made", text, AGAIN, rejected=rejected)
        if self.quit_after:
            app.quitting = True
