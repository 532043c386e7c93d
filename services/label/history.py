"""What other frames said of one, in the form in which a label keeps it, and back: the same bits. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from common.evidence import KeptExpected, KeptPose, KeptPrior, KeptSighting, MadeFrom
from common.geometry import Pose
from common.messages import DetectedMarker
from services.label.labelling import Around
from services.label.pose import Prior
from services.label.sightings import Expected, Sighting


def kept(markers: Sequence[DetectedMarker], around: Around) -> MadeFrom:
    """For a label. An object whose earlier poses aren't finite numbers, which JSON doesn't have, is left out."""
    return MadeFrom(
        markers=tuple(markers),
        steady=around.steady,
        previous=tuple(_prior(name, prior) for name, prior in around.previous.items() if _finite(prior.pose)),
        expected=tuple(_expected(item) for item in around.expected if _sound(item)),
    )


def around_of(made_from: MadeFrom) -> Around:
    """As it was given to ``kept``."""
    return Around(
        previous={
            item.object: Prior(_pose_of(item.pose), item.evidence, item.confirmed) for item in made_from.previous
        },
        expected=tuple(_expected_of(item) for item in made_from.expected),
        steady=made_from.steady,
    )


def _pose(pose: Pose) -> KeptPose:
    return KeptPose.model_validate({"rotation": pose.rotation.tolist(), "translation_mm": pose.translation.tolist()})


def _pose_of(kept_: KeptPose) -> Pose:
    return Pose(np.array(kept_.rotation), np.array(kept_.translation_mm))


def _prior(name: str, prior: Prior) -> KeptPrior:
    return KeptPrior(
        object=name, pose=_pose(prior.pose), evidence=float(prior.evidence), confirmed=bool(prior.confirmed)
    )


def _sighting(seen: Sighting) -> KeptSighting:
    return KeptSighting(time_ns=seen.time_ns, pose=_pose(seen.pose), covariance=tuple(seen.covariance.ravel().tolist()))


def _sighting_of(kept_: KeptSighting) -> Sighting:
    return Sighting(kept_.time_ns, _pose_of(kept_.pose), np.array(kept_.covariance).reshape(6, 6))


def _expected(item: Expected) -> KeptExpected:
    return KeptExpected(
        object=item.name,
        time_ns=item.time_ns,
        before=_sighting(item.before),
        earlier=None if item.earlier is None else _sighting(item.earlier),
        after=None if item.after is None else _sighting(item.after),
    )


def _expected_of(item: KeptExpected) -> Expected:
    return Expected(
        item.object,
        item.time_ns,
        _sighting_of(item.before),
        None if item.earlier is None else _sighting_of(item.earlier),
        None if item.after is None else _sighting_of(item.after),
    )


def _finite(pose: Pose) -> bool:
    return bool(np.isfinite(pose.matrix).all())


def _sound(item: Expected) -> bool:
    known = [seen for seen in (item.before, item.earlier, item.after) if seen is not None]
    return all(_finite(seen.pose) and np.isfinite(seen.covariance).all() for seen in known)
