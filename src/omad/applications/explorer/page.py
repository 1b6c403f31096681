"""The explorer's page: viser's sliders, buttons and text boxes around a scene."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import viser

from omad.common.errors import InputError, WorkError
from omad.common.files import writing
from omad.estimation.estimator import Estimator

from .drawing import SIGMAS, ObjectSpace, ObjectState
from .fitting import Fit, FitRequest, describe_fit, fit_demo, fit_file
from .places import Places, plain_name
from .scene import LAYERS, Scene

Colour = Literal["blue", "gray"]
Slider = viser.GuiSliderHandle[float]
Button = viser.GuiButtonHandle
LARGEST = 1e4
"""Of a slider's numbers."""
SAME = 1e-6
"""Radians or metres."""
NOWHERE = Places()
WHOLE_IMAGE, ON_PLANE = "whole image, mask or box", "largest thing on the dominant plane"


class ExplorerPage:
    """One page, the same in every browser that looks at it. Sliders and texts are attributes, for tests."""

    def __init__(
        self,
        server: viser.ViserServer,
        estimator: Estimator,
        components: int,
        seed: int,
        places: Places = NOWHERE,
    ) -> None:
        """``components``: how many numbers of beta are shown at once; the others are in a folder to open. ``places``:
        where files may lie that the page names; uploaded ones always may."""
        self.space = ObjectSpace(estimator.net.prior, estimator.category, estimator.surfaces)
        self.state = self.space.mean()
        self.fit: Fit | None = None
        self._estimator, self._server = estimator, server
        self._rng, self._demos = np.random.default_rng(seed), seed
        self._lock = threading.RLock()
        self._stale = True
        self._uploads = TemporaryDirectory(prefix="omad-explore-")
        self._places = replace(places, folders=(*places.folders, Path(self._uploads.name)))
        category = estimator.category
        self._scene = Scene(server, category.metres_per_unit, category.part_of_keypoint)
        server.gui.configure_theme(control_layout="fixed", show_logo=False, show_share_button=False)
        server.gui.set_panel_label(f"OMAD · {category.name}")
        self._build(components)
        self._redraw()

    def close(self) -> None:
        """Take uploaded files away."""
        self._uploads.cleanup()

    def _build(self, components: int) -> None:
        """The panel, from top to bottom."""
        gui = self._server.gui
        self.found = gui.add_markdown("", visible=False)
        shown = "A shape from the prior, with random joint states."
        self._on_click("Random object", lambda: self._set(self.space.random(self._rng)), shown)
        shown = "Every slider back to where it was at first."
        self._on_click("Mean object, at rest", lambda: self._set(self.space.mean()), shown, "gray")
        shown = "Every slider to the estimate."
        self.back = self._on_click("Back to what was found", self._show_estimate, shown, "gray")
        self.back.visible = False
        with gui.add_folder("Joints"):
            self.joints = [self._joint_slider(number) for number in range(len(self.space.joint_ranges))]
        first = min(components, self.space.components)
        with gui.add_folder("Shape: beta, in standard deviations"):
            self.sigmas = [*map(self._sigma_slider, range(first))]
        if first < self.space.components:
            with gui.add_folder("More of the shape", expand_by_default=False):
                self.sigmas += map(self._sigma_slider, range(first, self.space.components))
        with gui.add_folder("Fit a depth image or a cloud", expand_by_default=False):
            self._build_fit()
        with gui.add_folder("Show", expand_by_default=False):
            for layer in LAYERS:
                box = gui.add_checkbox(layer, True)
                box.on_update(lambda event, layer=layer: self._scene.show(layer, event.target.value))
            by_index = gui.add_checkbox("keypoints by index", False, hint="The same place, the same colour.")
            by_index.on_update(lambda _: self._scene.colour_by_index(by_index.value))

    def _build_fit(self) -> None:
        gui = self._server.gui
        hint = "fx,fy,cx,cy, or the path of a RealSense, Open3D, ROS or 3x3 file; not for clouds."
        self.intrinsics = gui.add_text("Intrinsics", "", hint=hint)
        self._upload("Upload intrinsics", "intrinsics", lambda path: setattr(self.intrinsics, "value", str(path)))
        self.segment = gui.add_dropdown("Object is", (WHOLE_IMAGE, ON_PLANE), hint="Which pixels are the object's.")
        self.box = gui.add_text("Box", "", hint="x1,y1,x2,y2 in pixels around the object.")
        self.mask = gui.add_text("Mask", "", hint="Path of an image, non-zero where the object is.")
        self._upload("Upload mask", "mask", lambda path: setattr(self.mask, "value", str(path)))
        hint = "Metres per stored number; empty: 0.001 for integers, else 1."
        self.scale = gui.add_text("Depth scale", "", hint=hint)
        self.path = gui.add_text("File", "", hint="Path of a depth image (PNG, TIFF, NPY) or a cloud (PLY, PCD, XYZ).")
        self._on_click("Fit this file", self._fit_path, "Estimate the object in it and set the sliders to it.")
        self._upload("Upload a file and fit it", "depth", self._fit_upload)
        self._on_click("Fit an unseen procedural object", self._fit_demo, "No file needed.")
        self._on_click("Clear", self._clear_fit, "Take the cloud away.", "gray")

    def _joint_slider(self, number: int) -> Slider:
        joint = self.space.joint_ranges[number]
        shown = (joint.low, joint.high, self.state.joint_states[number] / joint.per_unit)
        low, high, value = (round(one, 1) for one in shown)
        slider = self._server.gui.add_slider(f"{joint.name} [{joint.unit}]", low, high, 0.1, value)
        return self._moves(slider, lambda state, shown: self.space.with_joint(state, number, shown * joint.per_unit))

    def _sigma_slider(self, number: int) -> Slider:
        slider = self._server.gui.add_slider(f"beta {number + 1} [σ]", -SIGMAS, SIGMAS, 0.01, 0.0)
        return self._moves(slider, lambda state, shown: self.space.with_sigma(state, number, shown))

    def _moves(self, slider: Slider, change: Callable[[ObjectState, float], ObjectState]) -> Slider:
        def moved(event: viser.GuiEvent) -> None:
            if event.client is None:  # set by this page, not by a person
                return
            value = slider.value
            if not abs(value) <= LARGEST:  # no slider of ours sends that, or NaN
                return
            with self._lock:
                self.state = change(self.state, float(value))
                self._stale = True
                self._follow()
            self._redraw()

        slider.on_update(moved)
        return slider

    def _follow(self) -> None:
        """Sliders of joints that were held by another one, or taken along, to where they are."""
        for slider, state, joint in zip(self.joints, self.state.joint_states, self.space.joint_ranges, strict=True):
            if abs(slider.value * joint.per_unit - state) > SAME:
                slider.value = state / joint.per_unit

    def _on_click(self, label: str, act: Callable[[], None], hint: str, colour: Colour = "blue") -> Button:
        button = self._server.gui.add_button(label, hint=hint, color=colour)
        button.on_click(lambda event: self._told(event.client, act))
        return button

    def _upload(self, label: str, kind: str, take: Callable[[Path], None]) -> None:
        """Files of a ``kind`` lie apart: a depth image and its mask often have the same name."""
        button = self._server.gui.add_upload_button(label)

        def taken(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            file = event.target.value
            path = Path(self._uploads.name) / kind / plain_name(file.name)

            def keep() -> None:
                with writing(path):
                    path.parent.mkdir(exist_ok=True)
                    path.write_bytes(file.content)
                take(path)

            self._told(event.client, keep)

        button.on_upload(taken)

    def _told(self, client: viser.ClientHandle | None, act: Callable[[], None]) -> None:
        """Do what a button says; what is wrong with the input is said in the page that asked."""
        try:
            act()
        except (InputError, WorkError) as error:
            if client is not None:
                said = str(error).replace(f"{self._uploads.name}/", "")
                text = " ".join(said.replace(" --", " ").split())  # the page has fields, no options
                client.add_notification("That did not work", text, color="red", auto_close_seconds=15.0)

    def _redraw(self) -> None:
        """Moves that queue up while one is drawn are drawn at once, as the last of them says."""
        with self._lock:
            if self._stale:
                self._stale = False
                self._scene.draw(self.space.draw(self.state))

    def _set(self, state: ObjectState) -> None:
        """Sliders and scene to ``state``; a slider that does not reach far enough is made longer."""
        with self._lock, self._server.atomic():
            self.state, self._stale = state, True
            shown = [v / j.per_unit for v, j in zip(state.joint_states, self.space.joint_ranges, strict=True)]
            shown += self.space.sigmas(state).tolist()
            for slider, value in zip([*self.joints, *self.sigmas], shown, strict=True):
                slider.min, slider.max = min(slider.min, value), max(slider.max, value)
                slider.value = value
            self._redraw()

    def show_fit(self, fit: Fit) -> None:
        """Show a cloud and what was found in it, and set every slider to that."""
        with self._lock:
            self.fit = fit
            self._scene.show_fit(fit)
            self.found.content = describe_fit(fit)
            self.found.visible = self.back.visible = True
            self._show_estimate()

    def show_request(self, request: FitRequest) -> None:
        """Fill in the text boxes. Says nothing about the file."""
        options, boxes = request.options, (self.path, self.intrinsics, self.mask, self.box, self.scale)
        values = (request.file, options.intrinsics, options.mask, options.box, options.depth_scale)
        for box, value in zip(boxes, values, strict=True):
            box.value = "" if value is None else str(value)
        self.segment.value = WHOLE_IMAGE if options.segment is None else ON_PLANE

    def _show_estimate(self) -> None:
        if self.fit is not None:
            self._set(self.space.estimated(self.fit.estimate))

    def _fit_path(self) -> None:
        texts = (self.path.value, self.intrinsics.value, self.mask.value, self.box.value)
        request = FitRequest.of_texts(*texts, self.segment.value == ON_PLANE, self.scale.value, self._places)
        self.show_fit(fit_file(self._estimator, request))

    def _fit_upload(self, path: Path) -> None:
        self.path.value = str(path)
        self._fit_path()

    def _fit_demo(self) -> None:
        self.show_fit(fit_demo(self._estimator, self._demos))
        self._demos += 1

    def _clear_fit(self) -> None:
        with self._lock:
            self.fit = None
            self._scene.clear_fit()
            self.found.visible = self.back.visible = False
