"""A Foxglove layout for result.mcap: measured shape (at rest tension and probe) beside the model's, what is left,
tensions and pressure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ljjax.logs import Run, Signal

MEASURED, MODEL, LEFT, LEFT_TENDON, RIGHT_TENDON, PRESSURE = (
    "#9aa7b4",
    "#0b6e99",
    "#c77700",
    "#1b7f4b",
    "#8250a0",
    "#b3364a",
)
SHARES = {"Plot!shape": 40, "Plot!residual": 22, "Plot!probe": 22, "Plot!tension": 20, "Plot!pressure": 18}
"""Panels from above to below, and their shares of the height."""


def layout(runs: Sequence[Run], overlays: Sequence[Mapping[str, Mapping[str, Signal]]] = ()) -> dict[str, Any]:
    """The layout, as JSON holds it, for result.mcap of these runs, with what is written of a model beside each
    (`/sim`, `/residual`: signals by name). Samples are placed at their `header.stamp`."""
    told = {name for of in overlays for name in of.get("/sim", {})} or {"shape"}
    joints = max((r.signals["shape"].value.shape[1] for r in runs if "shape" in r.signals), default=1)
    names = ["θ"] if joints == 1 else [f"q{k + 1}" for k in range(joints)]

    def angles(topic: str, what: str, colour: str) -> list[dict[str, Any]]:
        return [
            _path(f"{topic}.position[{k}].@rad2deg", f"{name} {what}", colour, width=1 if joints > 1 else 1.5)
            for k, name in enumerate(names)
        ]

    tensions = [
        _path(f"{topic}.effort[{k}]", f"{side} {what}", colour, width)
        for k, (side, colour) in enumerate((("left", LEFT_TENDON), ("right", RIGHT_TENDON)))
        for topic, what, width in (("/real/cmd/tendons", "commanded", 1.0), ("/real/tendons", "measured", 2.0))
    ]
    if "tendons" in told:
        tensions.insert(0, _path("/sim/tendons.effort[0]", "left model", MODEL, 2.0))
    shapes, left = angles("/real/shape", "measured", MEASURED), angles("/residual/shape", "left", LEFT)
    if "shape" in told:
        shapes += angles("/sim/shape", "model", MODEL)
    else:
        left = [_path(f"/residual/{name}.effort[0]", f"{name} left", LEFT, 2.0) for name in ("tendons", "probe")]
    pressures = [
        _path("/real/cmd/pressure.fluid_pressure", "commanded", MEASURED, 1.0),
        _path("/real/pressure.fluid_pressure", "measured", PRESSURE, 2.0),
    ]
    panels = {
        "Plot!shape": _plot(
            "Shape: measured, and of the selected model" if "shape" in told else "Shape",
            "[deg]",
            shapes,
        ),
        "Plot!residual": _plot("Measured − model", "[deg]" if "shape" in told else "[N]", left),
        "Plot!probe": _plot(
            "Force on the probe",
            "[N]",
            [
                _path("/real/probe.effort[0]", "measured", MEASURED, 2.0),
                _path("/sim/probe.effort[0]", "model", MODEL, 1.5),
            ],
        ),
        "Plot!tension": _plot("Tendon tension", "[N]", tensions),
        "Plot!pressure": _plot("Absolute line pressure", "[Pa]", pressures),
    }
    if "probe" not in told:
        del panels["Plot!probe"]
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stack({name: SHARES[name] for name in panels}),
    }


def _path(value: str, label: str, colour: str, width: float) -> dict[str, Any]:
    return {
        "value": value,
        "label": label,
        "color": colour,
        "lineSize": width,
        "showLine": True,
        "enabled": True,
        "timestampMethod": "headerStamp",
    }


def _plot(title: str, unit: str, paths: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": list(paths),
        "yAxisLabel": unit,
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showPlotValuesInLegend": True,
        "sidebarDimension": 190,
    }


def _stack(shares: Mapping[str, float]) -> Any:
    """Panels one below the other, by splits of two."""
    (first, share), *others = shares.items()
    if not others:
        return first
    rest = dict(others)
    split = round(100 * share / (share + sum(rest.values())), 1)
    return {"direction": "column", "first": first, "second": _stack(rest), "splitPercentage": split}
