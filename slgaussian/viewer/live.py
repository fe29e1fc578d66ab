"""The page in the browser: a thin layer of viser over a session.

Whoever opens the address joins one conversation: question, answer, marks and changes are
everybody's, and each moves by himself. Every object is a part of the browser's scene by itself, so
that what does not change is not sent again, and a removed object is hidden without sending any.
"""

from __future__ import annotations

import contextlib
import io
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch

from slgaussian.errors import SLGaussianError
from slgaussian.gaussians import covariances
from slgaussian.language.query import Rules
from slgaussian.parts.extras import install_line
from slgaussian.scene import Camera
from slgaussian.viewer import shots, told
from slgaussian.viewer.door import Door, guarding
from slgaussian.viewer.session import Session
from slgaussian.viewer.stage import DEPTH, Stand

MOST_COVARIANCE = 6e4
"""Just below the greatest number of float16."""

NEAREST = 0.035 * DEPTH
"""Nothing nearer is drawn: so the picture of a camera does not hide the scene from who stands at
that camera."""

FRUSTUM = 0.03 * DEPTH
"""How far before a camera its picture hangs, at most."""

BESIDE = 0.12
"""And as a share of the distance to the next camera: else it hangs in the face of who stands there.
"""

PICTURE = 320
"""Longer side of the picture of a camera."""


def load_viser() -> Any:
    """The module viser.

    Raises
    ------
    SLGaussianError
        If it is not installed; the message says how to.
    """
    try:
        import viser
    except ImportError as error:
        raise SLGaussianError(
            f"the viewer needs viser, which is not installed ({error}); install it with "
            f"{install_line('view')}"
        ) from None
    return viser


class Page:
    """A session in browsers.

    Parameters
    ----------
    session : Session
    door : Door
        Where to listen. The page answers once this returns.

    Attributes
    ----------
    session : Session
    door : Door

    Raises
    ------
    SLGaussianError
        If viser is not installed, or is a version that cannot be guarded.
    """

    def __init__(self, session: Session, door: Door) -> None:
        viser = load_viser()
        self.session, self.door = session, door
        self._lock, self._ended = threading.RLock(), threading.Event()
        # viser announces itself on the standard output.
        with guarding(door), contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(
                host=door.host, port=door.port, label=session.source.name, verbose=False
            )
        # Any browser could ask for it, and it leads strangers here through a server elsewhere.
        self._server.request_share_url = lambda *_, **__: None
        self._server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, control_width="large"
        )
        self._set_stage()
        self._parts = self._add_parts()
        self._shown, self._hidden = session.colours(), session.hidden()
        self._cameras = self._add_cameras()
        self._add_panel()
        self._server.scene.on_click()(self._clicked)
        self._server.on_client_connect(self._arrived)
        self._looking = threading.Thread(target=self._look_through, daemon=True)
        self._looking.start()

    @property
    def clients(self) -> list[Any]:
        """viser's handles of those who look."""
        return list(self._server.get_clients().values())

    def stop(self) -> None:
        """End the server and all that it began."""
        with self._lock:
            self._ended.set()
        self._looking.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    # The scene

    def _set_stage(self) -> None:
        stage, camera = self.session.stage, self._server.initial_camera
        stand = stage.stand(stage.first, 1.5)
        self._server.scene.set_up_direction(tuple(stage.up))
        camera.position = tuple(stand.position)
        camera.look_at = tuple(stand.position + DEPTH * stage.first.c2w[:3, 2])
        camera.up = tuple(self._upright(stage.first))
        camera.fov, camera.near, camera.far = stand.fov, NEAREST, 1000 * DEPTH

    def _add_parts(self) -> dict[int, tuple[Any, np.ndarray]]:
        """The browser's part of each object, with the places of its Gaussians."""
        session, scale = self.session, self.session.stage.scale
        gaussians, colours, hidden = session.solid, session.colours(), session.hidden()
        order = np.argsort(session.labels, kind="stable")
        ids, starts = np.unique(session.labels[order], return_index=True)
        parts = {}
        for id_, places in zip(ids.tolist(), np.split(order, starts[1:]), strict=True):
            own = gaussians[torch.from_numpy(places)]
            spread = (covariances(own) * scale**2).numpy()
            parts[id_] = (
                self._server.scene.add_gaussian_splats(
                    f"/scene/{id_}",
                    centers=own.means.numpy() * scale,
                    covariances=spread.clip(-MOST_COVARIANCE, MOST_COVARIANCE),
                    rgbs=colours[places],
                    opacities=np.where(hidden[places], 0, own.opacities.numpy())[:, None],
                    visible=id_ not in session.removed,
                ),
                places,
            )
        return parts

    def _add_cameras(self) -> dict[str, Any]:
        scale, frusta = self.session.stage.scale, dict[str, Any]()
        if not self.session.cameras:
            return frusta
        centers = scale * np.stack([camera.center for camera in self.session.cameras.values()])
        apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
        nearest = np.where(apart > 0, apart, np.inf).min()
        ahead = min(FRUSTUM, BESIDE * nearest)
        for number, (name, camera) in enumerate(self.session.cameras.items()):
            stand = self.session.stage.stand(camera, camera.width / camera.height)
            half = np.tan(stand.fov / 2)
            # viser gives all frusta of one scale the same volume.
            size = ahead * np.cbrt(half * half * camera.width / camera.height / 3)
            frustum = self._server.scene.add_camera_frustum(
                f"/cameras/{number}",
                fov=stand.fov,
                aspect=camera.width / camera.height,
                scale=float(size),
                thickness=0.01 * ahead,
                color=(64, 224, 255),
                wxyz=stand.wxyz,
                position=camera.center * scale,
            )
            frustum.on_click(self._in_turn(partial(self._jump, name=name)))
            frusta[name] = frustum
        return frusta

    def _look_through(self) -> None:
        """Hang the pictures of the cameras, one after the other, while others look already."""
        if self.session.field is not None:
            with self._lock:
                self.session.things()
        for name, frustum in self._cameras.items():
            with self._lock:
                if self._ended.is_set():
                    return
                seen = self.session.look_through(name)
                step = max(1, round(max(seen.shape[:2]) / PICTURE))
                frustum.image = np.ascontiguousarray(seen[::step, ::step])

    def _refresh(self) -> None:
        """Send the colours and the objects that changed, and what is said of them."""
        session, colours = self.session, self.session.colours()
        hidden, opacities = session.hidden(), session.solid.opacities.numpy()
        with self._server.atomic():
            for id_, (part, places) in self._parts.items():
                part.visible = id_ not in session.removed
                if not np.array_equal(colours[places], self._shown[places]):
                    part.rgbs = colours[places]
                # What of a thing that stays was the fringe of one that is removed.
                if part.visible and not np.array_equal(hidden[places], self._hidden[places]):
                    part.opacities = np.where(hidden, 0, opacities)[places, None]
                    self._hidden[places] = hidden[places]
            self._shown = colours
            self._mode.value = session.look.mode
            self._marks.content = told.marks(session)
            if session.field is not None:
                self._found.content = told.answer(session)
                self._set_thing(told.thing(session))
        self._server.flush()

    def _set_thing(self, content: str) -> None:
        session = self.session
        self._thing.content = content
        for handle in self._of_selected:
            handle.disabled = not session.look.selected
        removed = [self._called(id_) for id_ in sorted(session.removed)]
        self._removed.options = ("none", *removed)
        self._removed.value = removed[-1] if removed else "none"
        self._kept.content = "Changes are not saved." if session.unsaved else ""

    def _called(self, id_: int) -> str:
        field = self.session.field
        name = "" if field is None else field.names.get(id_, "")
        return f"{id_} {name}".strip()

    # The panel

    def _add_panel(self) -> None:
        gui, session = self._server.gui, self.session
        asked = session.field is not None
        if not asked:
            gui.add_markdown(
                "A .ply holds no words and no objects, so it can be looked at and not asked. A "
                "field of photographs can: `slgaussian field a.jpg b.jpg`."
            )
        if asked:
            with gui.add_form("Ask") as form:
                self._words = gui.add_text("words", "", hint="several with commas; then Enter")
            form.on_submit(self._in_turn(lambda event: self._ask()))
            self._found = gui.add_markdown("")
            with gui.add_folder("How to take things", expand_by_default=False):
                self._near_best = gui.add_checkbox(
                    "near the best", True, hint="take what fits about as well as the best does"
                )
                self._share = gui.add_slider("how near", 0.05, 1.0, 0.05, Rules().share)
                self._threshold = gui.add_slider("or above", 0.05, 0.95, 0.01, 0.5, disabled=True)
                self._temperature = gui.add_slider("temperature", 1.0, 30.0, 0.5, 10.0)
            for handle in (self._near_best, self._share, self._threshold, self._temperature):
                handle.on_update(self._in_turn(self._rules_moved))
        with gui.add_folder("Look"):
            self._mode = gui.add_dropdown("show", session.modes, initial_value=session.look.mode)
            self._mode.on_update(self._in_turn(self._mode_chosen))
            self._guesses = gui.add_checkbox(
                "what is a guess", False, visible=session.gaussians.guessed is not None
            )
            self._unsure = gui.add_checkbox("what is unsure", False, visible=asked)
            for handle in (self._guesses, self._unsure):
                handle.on_update(self._in_turn(self._marks_chosen))
            self._marks = gui.add_markdown("")
            if asked:
                shown = gui.add_checkbox("cameras", True)
                shown.on_update(self._in_turn(lambda event: self._show_cameras(shown.value)))
                self._view = gui.add_dropdown("stand at", tuple(session.cameras))
                self._view.on_update(
                    self._in_turn(lambda event: self._jump(event, self._view.value))
                )
        if asked:
            self._add_thing()
        with gui.add_folder("Keep"):
            picture = gui.add_button("Picture from here")
            picture.on_click(self._in_turn(lambda event: self._send(event, "view.png")))
            turn = gui.add_button("Short turn from here")
            turn.on_click(self._in_turn(lambda event: self._send(event, "turn.gif")))

    def _add_thing(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Thing"):
            self._thing = gui.add_markdown(told.thing(self.session))
            like = gui.add_button("What is like it", disabled=True)
            like.on_click(self._in_turn(lambda event: self._set_thing(told.alike(self.session))))
            self._word = gui.add_text("word", "", hint="what you call it", disabled=True)
            teach = gui.add_button("Teach: this is it", disabled=True)
            teach.on_click(self._in_turn(lambda event: self._teach()))
            rename = gui.add_button("Call this one so", disabled=True)
            rename.on_click(self._in_turn(lambda event: self._rename()))
            remove = gui.add_button("Remove", disabled=True)
            remove.on_click(self._in_turn(lambda event: self._remove()))
            self._of_selected = (like, self._word, teach, rename, remove)
            self._removed = gui.add_dropdown("removed", ("none",))
            restore = gui.add_button("Bring it back")
            restore.on_click(self._in_turn(lambda event: self._restore()))
            undo = gui.add_button("Undo")
            undo.on_click(self._in_turn(lambda event: self._undo()))
            save = gui.add_button("Save")
            save.on_click(self._in_turn(lambda event: self._save()))
            self._kept = gui.add_markdown("")

    def _in_turn(self, act: Callable[[Any], None]) -> Callable[[Any], None]:
        """A callback of viser: one at a time, none by our own hand, refusals told to who asked."""

        def called(event: Any) -> None:
            if event.client is None:
                return
            with self._lock:
                if self._ended.is_set():
                    return
                try:
                    act(event)
                except SLGaussianError as error:
                    event.client.add_notification("Not done", str(error), auto_close_seconds=15)

        return called

    # What somebody does

    def _arrived(self, client: Any) -> None:
        stage = self.session.stage
        client.camera.fov = stage.stand(stage.first, client.camera.aspect).fov

    def _ask(self) -> None:
        texts = [text.strip() for text in self._words.value.split(",") if text.strip()]
        self.session.ask(texts, self._rules())
        self._refresh()

    def _rules(self) -> Rules:
        threshold = None if self._near_best.value else self._threshold.value
        temperature = self._temperature.value
        return Rules(threshold=threshold, share=self._share.value, temperature=temperature)

    def _rules_moved(self, event: Any) -> None:
        self._threshold.disabled = self._near_best.value
        self._share.disabled = not self._near_best.value
        if self.session.answer.hits:
            self._ask()

    def _mode_chosen(self, event: Any) -> None:
        self.session.show(self._mode.value, self._camera(event.client))
        self._refresh()

    def _marks_chosen(self, event: Any) -> None:
        self.session.mark(self._guesses.value, self._unsure.value)
        self._refresh()

    def _show_cameras(self, shown: bool) -> None:
        for frustum in self._cameras.values():
            frustum.visible = shown

    def _clicked(self, event: Any) -> None:
        self._in_turn(self._select)(event)

    def _select(self, event: Any) -> None:
        if self.session.field is None:
            return
        camera = self._camera(event.client)
        x, y = event.screen_pos
        self.session.click(camera, x * camera.width, y * camera.height)
        self._refresh()

    def _jump(self, event: Any, name: str) -> None:
        camera, at = self.session.cameras[name], event.client.camera
        stand = self.session.stage.stand(camera, at.aspect)
        with event.client.atomic():
            at.position = stand.position
            at.look_at = stand.position + DEPTH * camera.c2w[:3, 2]
            at.up_direction = self._upright(camera)
            at.fov = stand.fov

    def _stand_chosen(self, event: Any) -> None:
        self._jump(event, self._view.value)

    def _upright(self, camera: Camera) -> np.ndarray:
        """The scene's way up, turned about the camera's x axis alone: so it is not rolled."""
        up, right = self.session.stage.up, camera.c2w[:3, 0]
        upright = up - (up @ right) * right
        length = float(np.linalg.norm(upright))
        return upright / length if length > 0.1 else -camera.c2w[:3, 1]

    def _camera(self, client: Any) -> Camera:
        at = client.camera
        stand = Stand(np.array(at.wxyz), np.array(at.position), float(at.fov))
        return self.session.stage.camera(stand, at.image_width, at.image_height)

    def _teach(self) -> None:
        field, selected = self.session.field, self.session.look.selected
        if field is None or not selected:
            return
        self.session.change(field.teach(self._word.value, selected))
        self._refresh()

    def _rename(self) -> None:
        field, selected = self.session.field, self.session.look.selected
        if field is None or not selected:
            return
        self.session.change(field.named(selected, self._word.value))
        self._refresh()

    def _remove(self) -> None:
        field, selected = self.session.field, self.session.look.selected
        if field is None or not selected:
            return
        self.session.change(field.without([selected]))
        self._refresh()

    def _restore(self) -> None:
        field, chosen = self.session.field, self._removed.value
        if field is None or chosen == "none":
            return
        self.session.change(field.restored([int(chosen.split()[0])]))
        self._refresh()

    def _undo(self) -> None:
        self.session.undo()
        self._refresh()

    def _save(self) -> None:
        self.session.save()
        self._refresh()
        self._kept.content = f"Saved to {told.plain(str(self.session.source))}."

    def _send(self, event: Any, name: str) -> None:
        draw = shots.turn if name.endswith(".gif") else shots.picture
        made = draw(self.session, self._camera(event.client))
        event.client.send_file_download(name, made, save_immediately=True)
