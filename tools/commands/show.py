"""What the stack answers, as tables for a person."""

from __future__ import annotations

from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

Plain = dict[str, Any]

_GOOD = ("running", "streaming", "ended")
_GB = 1e9
_LATE_S = 2.0


def status_view(answer: Plain) -> RenderableType:
    """The whole stack: sentences first, then services, cameras, recordings."""
    parts: list[RenderableType] = [_headline(answer), *_warnings(answer), _console(answer), _services(answer)]
    if answer["cameras"]:
        parts.append(_cameras(answer))
    if answer["recordings"]:
        parts.append(_recordings(answer))
    return Group(*parts)


def _headline(answer: Plain) -> Text:
    free = answer["disk"]["free_bytes"]
    disk = "free disk unknown" if free is None else f"{free / _GB:.1f} GB free"
    running = [name for name, recording in answer["recordings"].items() if recording["phase"] == "running"]
    state = Text(f"recording {', '.join(running)}", style="bold red") if running else Text("ready", style="bold")
    if answer["missing"]:
        state = Text("not complete", style="bold yellow")
    rest = f"  session {answer['session']}  {disk}  {answer['backlog']} samples wait  prefix {answer['prefix']}"
    return Text.assemble(state, rest)


def _warnings(answer: Plain) -> list[Text]:
    lines = [f"{name} is missing" for name in answer["missing"]]
    for name, service in answer["services"].items():
        if service["last_error"]:
            lines.append(f"{name}: {service['last_error']}")
        lines.extend(f"{name}: {warning['message']}" for warning in service["warnings"])
    for name, recording in answer["recordings"].items():
        lines.extend(f"{name} waits on {camera}: {why}" for camera, why in recording["waiting_for"].items())
    return [Text(f"! {line}", style="yellow") for line in lines]


def _console(answer: Plain) -> Text:
    service = answer["services"].get("console")
    if service is None or not service["alive"]:
        return Text("no console runs; 'tagmill up' says why", style="dim")
    return Text(f"console at {service['texts'].get('url', 'an address that it has not told yet')}")


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _state(word: str, *, good: bool) -> Text:
    return Text(word, style="" if good else "yellow")


def _services(answer: Plain) -> Table:
    table = _table("services", "service", "state", "pid", "restarts", "per second", "lost")
    for name, service in answer["services"].items():
        word = service["phase"] if service["alive"] else f"silent for {service['age_s']:.0f} s"
        table.add_row(
            name,
            _state(word, good=service["alive"] and service["phase"] in _GOOD),
            str(service["pid"]),
            str(service["restarts"] or ""),
            ", ".join(f"{what} {rate:.1f}" for what, rate in service["rates"].items()),
            _counts(service["dropped"]),
        )
    return table


def _cameras(answer: Plain) -> Table:
    table = _table("cameras", "camera", "state", "picture", "frames/s", "intrinsics", "captured", "lost", "label")
    for name, camera in answer["cameras"].items():
        word = _camera_state(camera)
        share = answer["shares"]["label"].get(name)
        table.add_row(
            name,
            _state(word, good=word in (*_GOOD, "waiting")),
            f"{camera['width']}x{camera['height']}{' + depth' if camera['depth'] else ''}",
            f"{camera['fps']:g}",
            camera["calibration"],
            str(camera["captured"]),
            _counts(camera["lost"]),
            "" if share is None else f"label.{share}",
        )
    return table


def _camera_state(camera: Plain) -> str:
    """Its phase; with how long ago the last picture came where that matters."""
    if not camera["present"]:
        return f"silent for {camera['age_s']:.0f} s"
    phase, age_s = str(camera["phase"]), camera.get("frame_age_s")
    late = phase in ("lost", "stalled") or (phase == "streaming" and (age_s or 0) > _LATE_S)
    return f"{phase}, last picture {age_s:.0f} s ago" if late and age_s is not None else phase


def _recordings(answer: Plain) -> Table:
    table = _table("recordings", "recording", "state", "camera", "captured", "recorded", "refused", "lost", "waiting")
    for name, recording in answer["recordings"].items():
        for camera, account in recording["cameras"].items():
            table.add_row(name, recording["phase"], camera, *_account(account))
    return table


def ledger_view(ledger: Plain) -> RenderableType:
    """A recording's ledger, one row a camera; below it when a camera gave nothing."""
    gaps = [
        Text(f"! {camera} gave no picture {_gap(gap)}", style="yellow")
        for camera, account in sorted(ledger["cameras"].items())
        for gap in account.get("gaps", ())
    ]
    return Group(_ledger_table(ledger), *gaps)


def _gap(gap: Plain) -> str:
    since = f"since {gap['from']}" if gap["to"] is None else f"for {gap['seconds']:.1f} s from {gap['from']}"
    return f"{since}: {gap['reason']}"


def _ledger_table(ledger: Plain) -> Table:
    spec = ledger["spec"]
    why = f", {ledger['why']}" if ledger["why"] else ""
    table = _table(
        f"{spec['recording']}: {ledger['phase']}{why}",
        *("camera", "captured", "recorded", "refused", "lost", "waiting"),
    )
    for camera, account in sorted(ledger["cameras"].items()):
        table.add_row(camera, *_account(account))
    return table


def progress_line(ledger: Plain) -> Text:
    """One line on a recording that runs."""
    accounts = ledger["cameras"].values()
    recorded = sum(account["recorded"] for account in accounts)
    until = ledger["spec"]["until_count"]
    wanted = f" of {until * len(ledger['spec']['cameras'])}" if until else ""
    refused = sum(sum(account["refused"].values()) for account in accounts)
    lost = sum(sum(account["dropped"].values()) for account in accounts)
    return Text(f"{ledger['phase']}: {recorded}{wanted} recorded, {refused} refused, {lost} lost")


def _account(account: Plain) -> tuple[str, ...]:
    return (
        str(account["captured"]),
        str(account["recorded"]),
        _counts(account["refused"]),
        _counts(account["dropped"]),
        str(account["pending"] or ""),
    )


def _counts(counts: dict[str, int]) -> str:
    """Counts by reason: ``12 (no_object 10, not_due 2)``."""
    if not counts:
        return ""
    return f"{sum(counts.values())} ({', '.join(f'{why} {count}' for why, count in sorted(counts.items()))})"
