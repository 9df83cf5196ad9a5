"""session.json: the captures of a session, in order, and what is known of the rig that took them."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from lfrig.contracts.capture import PoseSpec
from lfrig.contracts.schema import Document, Model, NonNegative, Positive


class CameraMount(Model):
    """Where a camera that stands still sits: X_c = R X_plate + t at plate angle 0."""

    camera_from_plate: PoseSpec | None = None


class RigCameras(Model):
    """The rig's two cameras."""

    light_field: CameraMount | None = None
    target: CameraMount | None = None


class RigSpec(Model):
    """What is known of the rig. ``camera_from_plate`` directly here means the light-field camera's."""

    cameras: RigCameras = Field(default_factory=RigCameras)
    camera_from_plate: PoseSpec | None = None
    turntable_sigma_deg: NonNegative | None = None
    depth_range_m: tuple[Positive, Positive] | None = None

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

    @model_validator(mode="after")
    def _ids_are_plain(self) -> SessionDocument:
        for name in self.captures:
            if not name or name in {".", ".."} or "/" in name or "\\" in name:
                raise ValueError(f"capture id {name!r} is not a plain folder name")
        if len(set(self.captures)) != len(self.captures):
            raise ValueError("the same capture id is listed twice")
        return self
