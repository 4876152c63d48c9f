"""The unmodelled effects that ljjax knows, one small class each: `REGISTRY` by id.

Each hooks into the solver as `ljjax.effect` says and vanishes at its null. `load` adds a user's own from a file.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path

from ljjax.effect import Effect
from ljjax.effects.actuation import (
    ActuatorDeadband,
    ActuatorDelay,
    ActuatorGain,
    ActuatorLag,
    ActuatorRipple,
    ActuatorSaturation,
    TendonFriction,
    TendonSlack,
)
from ljjax.effects.friction import FrictionAsymmetry, LoadDependentFriction, ThermalDrift
from ljjax.effects.jamming import (
    FrictionSaturation,
    LayerHysteresis,
    LayerWear,
    PressureBias,
    PressureLag,
    PressureLeak,
    StiffnessSaturation,
)
from ljjax.effects.sensing import SensorBias, SensorDelay, SensorFilter, SensorScale
from ljjax.effects.structure import (
    BaseTilt,
    Contact,
    GravityDistribution,
    NonuniformStiffness,
    RestCurvature,
    StiffnessHardening,
    TipPayload,
    ViscoelasticCreep,
    ViscousDamping,
)
from ljjax.effects.varying import having
from ljjax.errors import InputError

LIBRARY: tuple[type[Effect], ...] = (
    ActuatorDelay,
    ActuatorDeadband,
    ActuatorGain,
    ActuatorSaturation,
    ActuatorLag,
    ActuatorRipple,
    TendonSlack,
    TendonFriction,
    PressureLag,
    PressureLeak,
    PressureBias,
    StiffnessSaturation,
    FrictionSaturation,
    LayerHysteresis,
    LayerWear,
    ViscoelasticCreep,
    ViscousDamping,
    StiffnessHardening,
    RestCurvature,
    BaseTilt,
    TipPayload,
    GravityDistribution,
    NonuniformStiffness,
    Contact,
    FrictionAsymmetry,
    LoadDependentFriction,
    ThermalDrift,
    SensorFilter,
    SensorScale,
    SensorBias,
    SensorDelay,
)
"""The effects that the package brings."""
REGISTRY: dict[str, type[Effect]] = {kind.id: kind for kind in LIBRARY}
"""Every effect by id, in the order in which several of them hook into a model."""
BLOCKS = ("actuation", "jamming", "structure", "friction", "sensing")


def build(effect: str, values: Mapping[str, float]) -> Effect:
    """An effect of the registry with these parameters, the others at their nulls; a varying one where they say how."""
    return having(REGISTRY[effect], values)(**values)


def register(kind: type[Effect]) -> type[Effect]:
    """Add an effect to the registry, as the last; a class decorator for one's own effects.

    Raises:
        InputError: no id, an id that is taken, no parameter, an unknown block.
    """
    known = REGISTRY.get(kind.id)
    if known is not None and known.__qualname__ != kind.__qualname__:
        raise InputError(f"effect {kind.id!r}: this id is taken by {known.__name__}; choose another")
    if not kind.id or not kind.sizes():
        raise InputError(f"effect {kind.__name__}: give it an id and at least one ljjax.effect.parameter")
    if kind.block not in BLOCKS:
        raise InputError(f"effect {kind.id}: its block is {kind.block!r}; expected one of {', '.join(BLOCKS)}")
    REGISTRY[kind.id] = kind
    return kind


def load(path: str | Path) -> list[type[Effect]]:
    """Register every effect that a Python file defines; runs the file.

    Raises:
        InputError: no such file, a file that fails, or one without effects.
    """
    path = Path(path)
    spec = importlib.util.spec_from_file_location(f"ljjax_effects_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(f"{path}: no such file; give a Python file that defines effects")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: {type(error).__name__}: {error}") from None
    found = [x for x in vars(module).values() if isinstance(x, type) and issubclass(x, Effect) and x is not Effect]
    found = [x for x in found if x.__module__ == spec.name]
    if not found:
        raise InputError(f"{path}: defines no effect; expected a class derived from ljjax.effect.Effect")
    for kind in found:
        kind.file = str(path.resolve())
    return [register(x) for x in found]
