"""Whether near and far things alike confirm a solved structure: the check of `processing.agreement`, inside the stage.

A backdrop that repeats holds a view in the wrong place with many more matches than what stands before it. Patches,
carried by the light fields' own depth and counted for near and far separately, are not outvoted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from lfrig.contracts.errors import GeometryRefused
from lfrig.processing.agreement import Agreement, measure_agreement
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import Evidence, LightField, Photo, Source
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.structure import Structure


def confirmation(
    structure: Structure, sources: Sequence[LightField], evidence: Sequence[Evidence], target: Photo, guide: Guide
) -> Agreement | None:
    """Agreement of all pictures by a structure's poses (the photo's last); None when some source's solved points do
    not give its light field a scale.
    """
    ready = [_source(structure, v, sources[v], evidence[v], guide) for v in range(len(sources))]
    known = [source for source in ready if source is not None]
    if len(known) < len(ready):
        return None
    return measure_agreement(known, target, structure.cameras[-1], structure.poses[-1])


def _source(structure: Structure, v: int, source: LightField, evidence: Evidence, guide: Guide) -> Source | None:
    """A source with the scale that its solved line or its solved points give it; None when they do not carry one."""
    line = structure.arrangement.lines(structure.parameters)[v]
    camera, pose = structure.cameras[v], structure.poses[v]
    scale = guide.fitted_line(structure, v) if line is None else line.scale(camera)
    return None if scale is None else Source(source, camera, pose, evidence, scale)


def is_photo_tied(
    structure: Structure, sources: Sequence[LightField], evidence: Sequence[Evidence], target: Photo, guide: Guide
) -> bool:
    """Whether some source ties the photo, near and far alike; the nearest ones are asked first, and one is enough."""
    poses, photo = structure.poses, structure.poses[-1]
    order = sorted(range(len(sources)), key=lambda v: rotation_angle_deg(poses[v].rotation, photo.rotation))
    for v in order:
        source = _source(structure, v, sources[v], evidence[v], guide)
        if source is not None and measure_agreement([source], target, structure.cameras[-1], photo).ties_photo():
            return True
    return False


def refuse_untied(confirmed: Agreement | None, names: Sequence[str], photo: str) -> None:
    """Refuse poses by which some picture is tied to the first source by nothing near, or by nothing at all.

    Raises
    ------
    GeometryRefused
        ``photo-disagrees`` where that is the photo only, else ``capture-disagrees``.
    """
    groups = confirmed.tied_groups() if confirmed else []
    if len(groups) < 2:
        return
    if [len(names)] in groups and len(groups) == 2:
        refuse_untied_photo(confirmed, photo)
    most = max(groups, key=len)
    alone = ", ".join(names[v] for group in groups if group is not most for v in group if v < len(names))
    _refuse_captures(alone or ", ".join(names))


def refuse_untied_corrections(confirmed: Agreement | None, corrected: Sequence[int], names: Sequence[str]) -> None:
    """Refuse poses by which a capture whose angle was corrected is tied to no other picture, near and far alike
    (``capture-disagrees``).
    """
    groups = confirmed.tied_groups() if confirmed else []
    alone = [names[v] for v in corrected if [v] in groups]
    if alone:
        _refuse_captures(", ".join(alone))


def _refuse_captures(named: str) -> NoReturn:
    raise GeometryRefused(
        f"captures {named}: nothing near is where the poses put it in the other captures",
        code="capture-disagrees",
        remedy="check turntable_deg of all captures (a backdrop that repeats fits at wrong angles too) and that "
        "nothing on the plate moved, or leave the named ones out with --sources",
    )


def refuse_untied_photo(confirmed: Agreement | None, photo: str) -> None:
    """Refuse a photo that only its own matches place, and nothing near ties to a source (``photo-disagrees``)."""
    if confirmed is not None and [len(confirmed.share)] in confirmed.tied_groups():
        raise GeometryRefused(
            f"photo {photo}: it fits the sources only in what is far away, not in what stands before it",
            code="photo-disagrees",
            remedy="take the photo from between the sources (a backdrop that repeats looks the same from elsewhere), "
            "or record its pose",
        )
