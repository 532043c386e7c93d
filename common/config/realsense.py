"""The rig file's keys of ``driver: realsense``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from common.config.section import Section

Setting = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Pixels = Annotated[int, Field(ge=16, le=16384)]


class RealSenseOptions(Section):
    """A camera by ``serial`` (None: the first found), or a ``recording`` of one (``.db3``, ``.bag``).

    ``depth_size`` (width, height): None = as the colour picture, or the nearest that the camera has. ``exposure``,
    ``gain`` and ``white_balance`` are the colour sensor's, in the SDK's units; None = automatic. ``preset`` is a visual
    preset by its name, ``preset_file`` a JSON file of the RealSense Viewer. ``sync``: the hardware synchronisation.
    """

    recording: Path | None = None
    loop: bool = False
    begin: Literal["on_start", "at_start"] = "on_start"
    pace: Literal["fps", "consumer"] = "fps"
    serial: str | None = None
    depth: bool = True
    depth_size: tuple[Pixels, Pixels] | None = None
    exposure: Setting | None = None
    gain: Setting | None = None
    white_balance: Setting | None = None
    depth_exposure: Setting | None = None
    depth_gain: Setting | None = None
    laser_power: Setting | None = None
    emitter: bool | None = None
    preset: str | None = None
    preset_file: Path | None = None
    sync: Literal["off", "master", "slave", "full_slave"] = "off"

    @field_validator("loop", "begin", "pace")
    @classmethod
    def _of_a_recording(cls, value: Any, info: ValidationInfo) -> Any:
        if info.data.get("recording") is None:
            raise PydanticCustomError("said", "belongs to a `recording`; an attached camera sends as it comes")
        return value

    @field_validator(
        "serial",
        "depth_size",
        "exposure",
        "gain",
        "white_balance",
        "depth_exposure",
        "depth_gain",
        "laser_power",
        "emitter",
        "preset",
        "preset_file",
        "sync",
    )
    @classmethod
    def _of_a_camera(cls, value: Any, info: ValidationInfo) -> Any:
        if info.data.get("recording") is not None:
            raise PydanticCustomError("said", "belongs to an attached camera; a recording can't be changed any more")
        return value

    @field_validator("gain", "depth_gain")
    @classmethod
    def _with_its_exposure(cls, value: float | None, info: ValidationInfo) -> float | None:
        exposure = f"{info.field_name}".replace("gain", "exposure")
        if value is not None and exposure in info.data and info.data[exposure] is None:
            raise PydanticCustomError(
                "said", "needs `{exposure}` too: while exposure is automatic, so is gain", {"exposure": exposure}
            )
        return value

    @field_validator("depth_size", "depth_exposure", "laser_power", "emitter", "preset")
    @classmethod
    def _with_depth(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("depth") is False:
            raise PydanticCustomError("said", "is of the depth sensor, which `depth: false` leaves off")
        return value
