"""One runner for all services: states, heartbeat, signals, exit codes; and liveness as others see it."""

from common.service.context import Context, Report, Service
from common.service.liveness import Liveness
from common.service.parent import die_with_parent
from common.service.runner import main
from common.service.states import Phase

__all__ = ["Context", "Liveness", "Phase", "Report", "Service", "die_with_parent", "main"]
