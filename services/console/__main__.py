"""``python -m services.console --rig F``."""

import sys

import common.first  # noqa: F401 - garbage, signals, threads: before all else
from common.errors import ConfigError
from common.service import Context, Service, main

EXTRA = frozenset({"fastapi", "uvicorn", "websockets", "prometheus_client", "starlette"})


def console(context: Context) -> Service:
    """The service; raises ConfigError where the extra isn't installed."""
    try:
        from services.console.service import ConsoleService
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in EXTRA:
            raise
        raise ConfigError(
            f"the console needs the package {error.name}; install it with: pip install 'tagmill[console]' "
            "(everything else works without the console)"
        ) from error
    return ConsoleService(context)


if __name__ == "__main__":
    sys.exit(main(console, "console"))
