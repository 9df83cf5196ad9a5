"""session.json: the captures of a session, in order, and what is known of the rig that took them."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, field_validator

from lfrig.contracts.capture import PoseSpec
from lfrig.contracts.schema import DepthRange, Document, Model, NonNegative, Positive

_NOT_IN_ID = set("/\\,\0\n\r")
"""Separators of paths, of lists on the command line, of lines."""


def check_capture_id(name: str) -> str:
    """Return ``name`` when it can be a capture's id, a visible plain folder name; else raise `ValueError`."""
    if not name or name != name.strip() or name.startswith(".") or _NOT_IN_ID & set(name):
        raise ValueError(f"capture id {name!r} is not a plain folder name")
    return name


class CameraMount(Model):
    """Where a camera that stands still sits: X_c = R X_plate + t at plate angle 0."""

    camera_from_plate: PoseSpec | None = None


class RigCameras(Model):
    """The rig's two cameras."""

    light_field: CameraMount | None = None
    target: CameraMount | None = None


class PlateSpec(Model):
    """How far the turntable's load reaches: a cylinder about the axis, from the plate up."""

    radius_m: Positive
    height_m: Positive


class RigSpec(Model):
    """What is known of the rig. ``camera_from_plate`` directly here means the light-field camera's."""

    cameras: RigCameras = Field(default_factory=RigCameras)
    camera_from_plate: PoseSpec | None = None
    turntable_sigma_deg: NonNegative | None = None
    depth_range_m: DepthRange | None = None
    plate: PlateSpec | None = None
    """Given, only what stands on the plate is computed."""

    def light_field_mount(self) -> PoseSpec | None:
        """Pose of the light-field camera to the plate, from either spelling."""
        mount = self.cameras.light_field
        return mount.camera_from_plate if mount and mount.camera_from_plate else self.camera_from_plate

    def target_mount(self) -> PoseSpec | None:
        """Pose of the target camera to the plate."""
        return self.cameras.target.camera_from_plate if self.cameras.target else None


class SessionDocument(Document):
    """A session: capture ids in order of shooting."""

    NAME: ClassVar[str] = "lfrig.session"

    captures: list[str] = Field(default_factory=list)
    rig: RigSpec = Field(default_factory=RigSpec)

    @field_validator("captures")
    @classmethod
    def _ids_are_plain(cls, value: list[str]) -> list[str]:
        for name in value:
            check_capture_id(name)
        if len(set(value)) != len(value):
            raise ValueError("the same capture id is listed twice")
        return value
