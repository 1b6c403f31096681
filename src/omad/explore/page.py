"""The explorer's page: viser's sliders, buttons and text boxes around a scene."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import viser

from ..errors import InputError
from ..estimator import Estimator
from .drawing import SIGMAS, ObjectSpace, ObjectState
from .fitting import Fit, FitRequest, describe_fit, fit_demo, fit_file
from .scene import LAYERS, Scene

Colour = Literal["blue", "gray"]
WHOLE_IMAGE, ON_PLANE = "whole image, mask or box", "largest thing on the dominant plane"


class ExplorerPage:
    """One page, the same in every browser that looks at it. Sliders and texts are attributes, for tests."""

    def __init__(self, server: viser.ViserServer, estimator: Estimator, components: int, seed: int) -> None:
        """``components``: how many numbers of beta are shown at once; the others are in a folder to open."""
        self.space = ObjectSpace(estimator.net.prior, estimator.category)
        self.state = self.space.mean()
        self.fit: Fit | None = None
        self._estimator, self._server = estimator, server
        self._rng = np.random.default_rng(seed)
        self._demos = seed
        self._lock = threading.RLock()
        self._stale = True
        self._uploads = TemporaryDirectory(prefix="omad-explore-")
        category = estimator.category
        self._scene = Scene(server, category.metres_per_unit, category.part_of_keypoint)
        server.gui.configure_theme(
            control_layout="fixed", control_width="medium", show_logo=False, show_share_button=False
        )
        server.gui.set_panel_label(f"OMAD · {category.name}")
        self._build(components)
        self._redraw()

    def close(self) -> None:
        """Take uploaded files away."""
        self._uploads.cleanup()

    # the panel, from top to bottom

    def _build(self, components: int) -> None:
        gui = self._server.gui
        self.found = gui.add_markdown("", visible=False)
        self._on_click("Random object", self._randomise, "A shape from the prior, with random joint states.")
        self._on_click("Mean object, at rest", self._reset, "Every slider back to where it was at first.", "gray")
        self.back = self._on_click(
            "Back to what was found", self._show_estimate, "Every slider to the estimate.", "gray"
        )
        self.back.visible = False
        with gui.add_folder("Joints"):
            self.joints = [self._joint_slider(number) for number in range(len(self.space.joint_ranges))]
        with gui.add_folder("Shape: beta, in standard deviations"):
            first = min(components, self.space.components)
            self.sigmas = [self._sigma_slider(number) for number in range(first)]
        if first < self.space.components:
            with gui.add_folder("More of the shape", expand_by_default=False):
                self.sigmas += [self._sigma_slider(number) for number in range(first, self.space.components)]
        with gui.add_folder("Fit a depth image or a cloud", expand_by_default=False):
            self._build_fit()
        with gui.add_folder("Show", expand_by_default=False):
            for layer in LAYERS:
                self._layer_box(layer)
            by_index = gui.add_checkbox("keypoints by index", False, hint="The same place, the same colour.")
            by_index.on_update(lambda _: self._scene.colour_by_index(by_index.value))

    def _build_fit(self) -> None:
        gui = self._server.gui
        self.intrinsics = gui.add_text(
            "Intrinsics", "", hint="fx,fy,cx,cy, or the path of a RealSense, Open3D, ROS or 3x3 file; not for clouds."
        )
        self._upload("Upload intrinsics", lambda path: setattr(self.intrinsics, "value", str(path)))
        self.segment = gui.add_dropdown("Object is", (WHOLE_IMAGE, ON_PLANE), hint="Which pixels are the object's.")
        self.box = gui.add_text("Box", "", hint="x1,y1,x2,y2 in pixels around the object.")
        self.mask = gui.add_text("Mask", "", hint="Path of an image, non-zero where the object is.")
        self._upload("Upload mask", lambda path: setattr(self.mask, "value", str(path)))
        self.scale = gui.add_text(
            "Depth scale", "", hint="Metres per stored number; empty: 0.001 for integers, else 1."
        )
        self.path = gui.add_text("File", "", hint="Path of a depth image (PNG, TIFF, NPY) or a cloud (PLY, PCD, XYZ).")
        self._on_click("Fit this file", self._fit_path, "Estimate the object in it and set the sliders to it.")
        self._upload("Upload a file and fit it", self._fit_upload)
        self._on_click("Fit an unseen procedural object", self._fit_demo, "No file needed.")
        self._on_click("Clear", self._clear_fit, "Take the cloud away.", "gray")

    def _joint_slider(self, number: int) -> viser.GuiSliderHandle[float]:
        joint = self.space.joint_ranges[number]
        slider = self._server.gui.add_slider(
            f"{joint.name} [{joint.unit}]", round(joint.low, 1), round(joint.high, 1), 0.1,
            round(self.state.joint_states[number] / joint.per_unit, 1),
        )  # fmt: skip

        def moved(event: viser.GuiEvent) -> None:
            if event.client is not None:  # set by a person, not by this page
                self._change(lambda state: state.with_joint(number, slider.value * joint.per_unit))

        slider.on_update(moved)
        return slider

    def _sigma_slider(self, number: int) -> viser.GuiSliderHandle[float]:
        slider = self._server.gui.add_slider(f"beta {number + 1} [σ]", -SIGMAS, SIGMAS, 0.01, 0.0)

        def moved(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._change(lambda state: self.space.with_sigma(state, number, slider.value))

        slider.on_update(moved)
        return slider

    def _layer_box(self, layer: str) -> None:
        box = self._server.gui.add_checkbox(layer, True)
        box.on_update(lambda _: self._scene.show(layer, box.value))

    def _on_click(
        self, label: str, act: Callable[[], None], hint: str, colour: Colour = "blue"
    ) -> viser.GuiButtonHandle:
        button = self._server.gui.add_button(label, hint=hint, color=colour)
        button.on_click(lambda event: self._told(event.client, act))
        return button

    def _upload(self, label: str, take: Callable[[Path], None]) -> None:
        button = self._server.gui.add_upload_button(label)

        def taken(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            file = event.target.value
            path = Path(self._uploads.name) / Path(file.name).name
            path.write_bytes(file.content)
            self._told(event.client, lambda: take(path))

        button.on_upload(taken)

    def _told(self, client: viser.ClientHandle | None, act: Callable[[], None]) -> None:
        """Do what a button says; what is wrong with the input is said in the page that asked."""
        try:
            act()
        except InputError as error:
            if client is not None:
                text = " ".join(str(error).split())
                client.add_notification("That did not work", text, color="red", auto_close_seconds=15.0)

    # what the sliders show

    def _change(self, change: Callable[[ObjectState], ObjectState]) -> None:
        with self._lock:
            self.state = change(self.state)
            self._stale = True
        self._redraw()

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

    def _reset(self) -> None:
        self._set(self.space.mean())

    def _randomise(self) -> None:
        self._set(self.space.random(self._rng))

    # what a file shows

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
        self.path.value = str(request.file)
        self.intrinsics.value = request.intrinsics or ""
        self.mask.value = "" if request.mask is None else str(request.mask)
        self.box.value = request.box or ""
        self.scale.value = "" if request.depth_scale is None else str(request.depth_scale)
        self.segment.value = WHOLE_IMAGE if request.segment is None else ON_PLANE

    def _show_estimate(self) -> None:
        if self.fit is not None:
            self._set(self.space.estimated(self.fit.estimate))

    def _fit_path(self) -> None:
        texts = (self.path.value, self.intrinsics.value, self.mask.value, self.box.value)
        request = FitRequest.of_texts(*texts, self.segment.value == ON_PLANE, self.scale.value)
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
