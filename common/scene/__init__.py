"""The renderer: configured boxes with their markers, from known poses, in a room that is never the same twice."""

from common.scene.boards import BOARD
from common.scene.burnt import burn_number, read_number
from common.scene.objects import Patterns
from common.scene.scene import DEFAULT_FRUSTUM, Rendered, Scene, SceneCamera
from common.scene.truth import true_objects

__all__ = [
    "BOARD",
    "DEFAULT_FRUSTUM",
    "Patterns",
    "Rendered",
    "Scene",
    "SceneCamera",
    "burn_number",
    "read_number",
    "true_objects",
]
