"""Intrinsics for the picture size that a camera really gives."""

from __future__ import annotations

from typing import Literal

from common.config.calibration import same_shape
from common.errors import CameraError
from common.geometry import CameraModel, model_difference
from common.labels import CameraLabel

_FAR_APART = 0.01
"""Calibration and factory contradict each other beyond this share of the picture's diagonal."""


def label_of(
    name: str,
    camera: CameraModel,
    *,
    intrinsics_from: Literal["calibration", "factory", "truth", "guess"],
    serial: str | None = None,
) -> CameraLabel:
    """A camera model in the form in which a camera describes itself."""
    return CameraLabel.model_validate(
        {
            "name": name,
            "width": camera.width,
            "height": camera.height,
            "matrix": tuple(tuple(float(value) for value in row) for row in camera.matrix),
            "distortion": tuple(float(value) for value in camera.distortion),
            "model": camera.model,
            "intrinsics_from": intrinsics_from,
            "serial": serial,
        }
    )


def fit_to_size(calibration: CameraLabel, width: int, height: int) -> tuple[CameraLabel, tuple[str, ...]]:
    """The calibration for pictures of ``width`` x ``height``, and what to tell the operator about it.

    Pictures of the same aspect ratio as the calibration's are taken for scaled ones. Raises CameraError for others:
    cut pictures have a principal point that nobody knows.
    """
    if (calibration.width, calibration.height) == (width, height):
        return calibration, ()
    across, down = width / calibration.width, height / calibration.height
    sizes = (
        f"the calibration of {calibration.name} is for {calibration.width}x{calibration.height}, "
        f"its pictures are {width}x{height}"
    )
    if not same_shape(calibration, width, height):
        raise CameraError(f"{sizes}; calibrate at the size that is used")
    (fx, skew, cx), (_, fy, cy), last = calibration.matrix
    # Integer = pixel centre, so it is the picture's edge at -0.5 that stays where it is.
    matrix = (
        (fx * across, skew * across, (cx + 0.5) * across - 0.5),
        (0.0, fy * down, (cy + 0.5) * down - 0.5),
        last,
    )
    scaled = calibration.model_copy(update={"width": width, "height": height, "matrix": matrix})
    return scaled, (f"{sizes}: scaled by {across:.3f}; true only if the camera scales its picture and doesn't cut it",)


def known_or_guessed(
    name: str, calibration: CameraLabel | None, width: int, height: int, serial: str | None = None
) -> tuple[CameraLabel, tuple[str, ...]]:
    """Intrinsics of a camera that doesn't know its own, and what to tell the operator about them.

    The calibration's if there is one (see ``fit_to_size``), else a guess. ``serial`` is the camera's that is open.
    """
    if calibration is None:
        warning = (
            f"camera {name} has no calibration: its intrinsics are guessed, so distances are too; "
            "run `tagmill calibrate` and name the file as `calibration`"
        )
        return label_of(name, CameraModel.guess(width, height), intrinsics_from="guess", serial=serial), (warning,)
    label, warnings = fit_to_size(calibration, width, height)
    bound = label.model_copy(update={"serial": serial or calibration.serial})
    return bound, (*warnings, *_of_another(name, calibration, serial))


def known_or_factory(
    name: str, calibration: CameraLabel | None, factory: CameraModel, serial: str | None = None
) -> tuple[CameraLabel, tuple[str, ...]]:
    """Intrinsics of a camera that brings its own from the factory, and what to tell the operator about them.

    The calibration's if there is one (see ``fit_to_size``); if it lies far from the factory's, that is told: one of
    the two is wrong. ``factory`` is for the pictures that the camera gives.
    """
    if calibration is None:
        return label_of(name, factory, intrinsics_from="factory", serial=serial), ()
    label, warnings = fit_to_size(calibration, factory.width, factory.height)
    apart = model_difference(factory, CameraModel.from_label(label))
    told: tuple[str, ...] = ()
    if apart.edge_px > _FAR_APART * (factory.width**2 + factory.height**2) ** 0.5:
        words = f"the calibration of {name} and its factory's intrinsics differ by {apart.edge_px:.0f} px"
        where = f"at the picture's edge ({apart.centre_px:.0f} px in the middle)"
        cure = "calibrate again, or take `calibration` out of the rig file to use the factory's"
        told = (f"{words} {where}: {cure}",)
    bound = label.model_copy(update={"serial": serial or calibration.serial})
    return bound, (*warnings, *_of_another(name, calibration, serial), *told)


def _of_another(name: str, calibration: CameraLabel, serial: str | None) -> tuple[str, ...]:
    """A warning if a calibration was made with another camera; some name more than the number as their serial."""
    if serial is None or calibration.serial is None or calibration.serial in serial:
        return ()
    return (f"the calibration of {name} is of the camera {calibration.serial}, this one is {serial}: calibrate it",)
