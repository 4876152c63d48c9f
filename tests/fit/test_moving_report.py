"""The report of a dynamic fit and what the terminal says: whether to trust it, every run, the numbers of fit.json."""

from __future__ import annotations

import base64
import dataclasses
import html
import io
import json
import re
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.fit import fit
from ljjax.fit.moving import DynamicResult
from ljjax.fit.moving_figures import CLOUD, residuals, sliding, traces
from ljjax.fit.moving_report import SOME, _drawn, noise_deg, rms_deg, verdict
from ljjax.fit.show import show, show_many
from ljjax.inputs import Inputs
from ljjax.model import UNITS, Model, get, replace
from ljjax.modelfile import ModelFile, load
from ljjax.page import number
from ljjax.simulation import simulate

FREE = ("elastic.c3", "jamming.c4", "friction.mu_c", "friction.sigma2")
NOISE_RAD = 2e-4
P_ATM = 101_325.0


def robot(n: int = 2) -> Model:
    """OctRobot-I with assumed friction, short."""
    model = load(OCTROBOT / "nominal.toml").model
    return dataclasses.replace(model, chain=dataclasses.replace(model.chain, segments=n))


def log(run_of, name: str, push_n: float, seed: int):
    """Pulls to either side over 3 s, the vacuum rising at 1.5 s, as a log."""
    t = np.arange(0.0, 3.0, 0.01)
    pull = push_n * np.sin(2 * np.pi * 0.8 * np.maximum(t - 0.2, 0.0))
    tendons = np.round(np.stack([np.maximum(pull, 0), np.maximum(-pull, 0)], 1), 2)
    vacuum = np.where(t < 1.5, 0.0, 10.0)
    theta = simulate(robot(), Inputs(jnp.asarray(t), jnp.asarray(tendons), jnp.asarray(vacuum))).theta
    noisy = np.asarray(theta) + NOISE_RAD * np.random.default_rng(seed).normal(size=len(t))
    commands = {"cmd_tendons": (t, tendons), "cmd_pressure": (t, P_ATM - 1000 * vacuum)}
    return run_of("pulls", name, **commands, shape=(t, noisy))


@pytest.fixture(scope="session")
def found(run_of) -> DynamicResult:
    """A fit to one run of two, the other held out, of four parameters that begin 15 % off."""
    truth = robot()
    start = replace(truth, {path: 1.15 * float(get(truth, path)) for path in FREE})
    start = replace(start, {"friction.mu_s": 1.3 * float(get(truth, "friction.mu_s"))})
    runs = [log(run_of, name, push, i) for i, (name, push) in enumerate((("one.mcap", 9.0), ("two.mcap", 6.0)))]
    frozen = [path for path in UNITS if path not in FREE]
    result = fit(ModelFile(start), runs[:1], held_out=runs[1:], frozen=frozen)
    assert isinstance(result, DynamicResult)
    return result


def page_of(result: DynamicResult) -> str:
    return result.report(result.as_dict())


@pytest.fixture(scope="session")
def page(found) -> str:
    return page_of(found)


def text_of(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page.split("</style>")[1]))


def changed(result: DynamicResult, **change: Any) -> DynamicResult:
    """The result with another estimate."""
    return dataclasses.replace(result, estimate=dataclasses.replace(result.estimate, **change))


def printed(show_it, *args: Any) -> str:
    screen = io.StringIO()
    show_it(*args, Console(file=screen, highlight=False))
    return screen.getvalue()


def test_the_report_loads_nothing_and_stays_small(page):
    assert not re.search(r"https?:|@import|url\(|<script|<link|<iframe", page)
    sources = re.findall(r'src="([^"]*)"', page)
    assert sources and all(s.startswith("data:image/svg+xml;base64,") for s in sources)
    for source in sources:
        links = re.findall(r'(?:href|src)="([^"]*)"', base64.b64decode(source.split(",")[1]).decode())
        assert all(link.startswith(("#", "data:")) for link in links)
    assert len(page) < 1.5e6


def test_every_picture_is_there_and_can_be_said(page):
    alts = re.findall(r'<img alt="([^"]*)"', page)
    titles = ["Intervals", "Correlations", "Friction in steady sliding", "Descent", "Estimates on the way"]
    titles += [f"Residuals over {axis}" for axis in ("rate", "angle", "pressure")]
    for run in ("one.mcap", "two.mcap, not fitted"):
        titles += [run, f"{run}, loop"]
    assert sorted(alt.split(". ")[0] for alt in alts) == sorted(titles)
    assert all(len(alt) > 40 for alt in alts)


def test_the_numbers_shown_are_those_of_fit_json(found, page):
    data, text = json.loads(json.dumps(found.as_dict(), allow_nan=False)), text_of(page)
    for path in FREE:
        p = data["parameters"][path]
        assert f"{path} {number(p['value'], 4)} {number(p['sd'])} {p['unit']} {p['verdict']}" in text
    for r, fitted in zip(data["runs"], ("fitted", "not fitted"), strict=True):
        rms, largest = (number(float(np.degrees(r[key]))) for key in ("rms", "largest"))
        assert f"{r['run_id']} pulls {fitted} {r['samples']} {rms} {largest}" in text
    for x in data["inputs"]:
        assert x["sha256"][:16] in text and x["file"] in text
    assert f"{number(float(np.degrees(data['held_out_rms'])))}° RMS error of θ, 1 run not fitted" in text
    frozen = [path for path, p in data["parameters"].items() if p["verdict"] in ("frozen", "assumed")]
    assert len(frozen) == len(UNITS) - len(FREE) and all(path in text.split("not fitted")[-1] for path in frozen)


def test_errors_in_degrees_are_of_all_samples(found):
    error = found.estimate.windows.y[:, 0] - found.estimate.predicted[:, 0]
    assert rms_deg(found) == pytest.approx(np.degrees(np.sqrt(np.mean(error**2))))
    assert noise_deg(found) == pytest.approx(np.degrees(NOISE_RAD), rel=0.15)


def test_a_reader_is_told_at_once_whether_to_trust_it(found, page):
    good, why = verdict(found)
    assert good and "down to their noise, runs it has not seen included; all 4" in why
    assert page.index(why) < page.index("<img") and "Beware" not in page

    unsure = changed(found, covariance=found.estimate.covariance * 1e8, white=found.estimate.white * 1e8)
    lacking = changed(found, sigma=found.estimate.sigma * 5)
    assert found.held_out is not None
    windows = dataclasses.replace(found.held_out.windows, y=found.held_out.windows.y + 0.01)
    astray = dataclasses.replace(found, held_out=dataclasses.replace(found.held_out, windows=windows))
    for result, said in (
        (changed(found, converged=False), "Do not use it yet: the search did not converge"),
        (unsure, " of 4 fitted parameters can be relied on"),
        (lacking, "the model lacks something they show"),
        (astray, "errors on runs it has not seen"),
    ):
        good, why = verdict(result)
        assert not good and said in why


@pytest.fixture(scope="session")
def odd(found, points) -> DynamicResult:
    """The result, had it everything: not converged, unsure, sensitive, a parameter at its bound, a profile, points."""
    probe = points("probe", [100.0, 120.0, 150.0], [0.0, 0.0, 10.0])
    p = found.parameters["jamming.c4"]
    z = np.linspace(-3, 3, 61)
    result = changed(
        found,
        problem=dataclasses.replace(found.estimate.problem, bounds={"elastic.c3": (0.1, 0.2)}, points=[probe]),
        statics=[(np.array([103.0, 116.0, 150.5]), 1.0)],
        covariance=found.estimate.covariance * 1e8,
        converged=False,
        step_error=np.array([0.1]),
    )
    return dataclasses.replace(result, profiles={p.name: (p.value + p.sd * z, z**2)})


@pytest.fixture(scope="session")
def odd_text(odd) -> str:
    return html.unescape(text_of(page_of(odd)))


def test_warnings_and_verdicts_reach_page_and_terminal(odd, odd_text):
    screen = printed(show, odd, "out")
    assert len(odd.warnings) > 3
    for warning in odd.warnings:
        assert warning in odd_text and f"beware: {warning}" in screen
    assert "not identifiable" in odd_text and "Sensitive: hangs on" in odd_text
    assert re.search(r"one.mcap: .*, sensitive", screen) and "did not converge" in screen


def test_a_parameter_at_its_bound_has_no_interval_and_the_page_copes(odd_text):
    assert "elastic.c3 0.2 – N·m/rad at bound – … –" in odd_text and " nan" not in odd_text


def test_points_beside_the_runs_are_reported_by_pressure(odd_text):
    assert "probe 0 2 3.54 0.5 4 N/m probe 10 1 0.5 -0.5 -0.5 N/m" in odd_text


def test_profiles_are_drawn_with_their_interval(found, odd, odd_text):
    low, high = odd.as_dict()["profiles"]["jamming.c4"]["ci95"]
    assert (high - low) / (2 * found.parameters["jamming.c4"].sd) == pytest.approx(1.96, rel=1e-2)
    assert f"95 % interval {number(low, 4)} … {number(high, 4)}" in odd_text


def test_what_drives_a_run_is_what_was_commanded(found):
    shown = traces(found)
    assert [t.said.role for t in shown] == ["train", "held_out"]
    for trace, run in zip(shown, (*found.runs, *found.held_out_runs), strict=True):
        t = run.signal("shape").t
        np.testing.assert_allclose(trace.tension, run.signal("cmd_tendons").held_at(t))
        np.testing.assert_allclose(trace.vacuum, run.vacuum_kpa("cmd_pressure").held_at(t)[:, 0])
        np.testing.assert_allclose(trace.measured, np.degrees(run.signal("shape").value[:, 0]))
        assert np.sqrt(np.mean(np.radians(trace.error) ** 2)) == pytest.approx(trace.said.rms)


def test_the_friction_curve_and_its_band_are_the_model_s(found):
    """Against formulas of its own, and the band against samples of the covariance."""
    f, j = found.model.friction, found.model.jamming
    v, u_p = np.geomspace(1e-3, 1.0, 7), 10.0

    def curve(c4, mu_c, sigma2):
        rho = mu_c + (float(f.mu_s) - mu_c) * np.exp(-((v / float(f.v_s)) ** float(f.sigma3)))
        return (c4 + float(j.c5) * np.sqrt(u_p)) * (rho + sigma2 * v)

    middle, sd = sliding(found, u_p, v)
    np.testing.assert_allclose(middle, curve(float(j.c4), float(f.mu_c), float(f.sigma2)), rtol=1e-4)
    order = [found.names.index(path) for path in ("jamming.c4", "friction.mu_c", "friction.sigma2")]
    centre = [float(j.c4), float(f.mu_c), float(f.sigma2)]
    small = 1e-4 * found.covariance[np.ix_(order, order)]  # small, so that the first order is all
    draws = np.random.default_rng(0).multivariate_normal(centre, small, size=4000)
    np.testing.assert_allclose(sd, 100 * np.std([curve(*x) for x in draws], axis=0), rtol=0.06)


def test_residuals_by_pressure_show_where_a_law_fails():
    rng = np.random.default_rng(0)
    vacuum = np.repeat([0.0, 10.0, 40.0], 3000)
    error = 0.01 * rng.normal(size=9000) + np.where(vacuum == 40.0, 0.05, 0.0)
    trace: Any = SimpleNamespace(vacuum=vacuum, error=error)
    (ax,) = residuals([trace], "pressure", 0.01).axes
    x, median = np.asarray(ax.lines[0].get_xydata()).T
    np.testing.assert_allclose(x, [0, 10, 40])
    np.testing.assert_allclose(median, [0, 0, 0.05], atol=2e-3)
    assert np.shape(ax.collections[0].get_offsets()) == (CLOUD, 2)


@pytest.mark.parametrize("count", [10, 300, 3000])
def test_residuals_of_a_short_run_that_never_rests_are_drawn_too(count):
    rate, error = np.random.default_rng(0).normal(size=(2, count))
    trace: Any = SimpleNamespace(rate=rate, error=error)
    (ax,) = residuals([trace], "rate", 0.01).axes
    x, median = np.asarray(ax.lines[0].get_xydata()).T
    assert 1 <= len(x) <= 20 and np.degrees(rate.min()) < x.min() <= x.max() < np.degrees(rate.max())
    assert np.max(np.abs(median)) < np.max(np.abs(error))


def test_of_many_runs_the_best_and_the_worst_are_drawn_and_that_is_said():
    rms = np.random.default_rng(0).permutation(np.arange(1.0, 31.0))
    many: Any = [SimpleNamespace(said=SimpleNamespace(rms=x)) for x in rms]
    drawn, said = _drawn(many)
    assert len(drawn) == SOME and (drawn[0].said.rms, drawn[-1].said.rms) == (1.0, 30.0)
    assert f"{SOME} of 30 runs, from the best explained to the worst" in said
    assert _drawn(many[:12]) == (many[:12], "")


def test_the_terminal_says_the_values_the_errors_and_the_verdict(found):
    screen = printed(show, found, "out")
    for path in FREE:
        p = found.parameters[path]
        row = [cell.strip() for cell in next(x for x in screen.splitlines() if path in x).split("│")[1:-1]]
        assert row == [path, number(p.value, 4), number(p.sd, 2), p.unit, "identifiable"]
    for e in found.run_errors:
        assert f"{e.run_id}: {number(float(np.degrees(e.rms)))}° RMS over 300 samples" in screen
    assert verdict(found)[1] in screen and screen.endswith("Report: out/report.html\n")


def test_many_robots_are_a_row_each_and_failures_are_named(found):
    results = {"robot-a": found, "robot-b": InputError("b.mcap: no excitation")}
    screen = printed(show_many, results, "out")
    (row,) = [line for line in screen.splitlines() if "robot-a" in line]
    cells = [cell.strip() for cell in row.split("│")[1:-1]]
    assert cells[:4] == ["robot-a", number(rms_deg(found)), number(rms_deg(found, "held_out")), "4 of 4"]
    c3, alpha1 = (found.parameters[path] for path in ("elastic.c3", "gravity.alpha1"))
    assert f"{number(c3.value)}±{number(100 * c3.sd / c3.value, 1)}%" in cells
    assert f"({number(alpha1.value)})" in cells  # frozen
    assert "1 of 2 robots" in screen and "robot-b: b.mcap: no excitation" in screen
