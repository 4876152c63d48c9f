"""What a fit writes: fit.json, model.toml, report.html and result.mcap, each as another program would read it."""

from __future__ import annotations

import base64
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from ljjax import modelfile
from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.fit import fit
from ljjax.fit.result import StaticResult
from ljjax.logs import read_all
from ljjax.model import UNITS, get

LOGS = ("identification", "open_loop_stiffness")
FILES = ["fit.json", "model.toml", "report.html", "result.mcap"]


def test_all_four_are_there_and_nothing_else(octrobot):
    assert sorted(p.name for p in octrobot.folder.iterdir()) == FILES
    assert [p.name for p in octrobot.folder.parent.iterdir()] == ["fit"]


def numbers(x):
    if isinstance(x, dict):
        x = list(x.values())
    if isinstance(x, list):
        for item in x:
            yield from numbers(item)
    elif isinstance(x, float):
        yield x


def test_fit_json_is_strict_json(octrobot):
    text = (octrobot.folder / "fit.json").read_text(encoding="utf-8")
    strict = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert all(math.isfinite(x) for x in numbers(strict))


def test_fit_json_says_what_was_fitted_from_what(octrobot):
    found = octrobot.json
    assert found["schema"] == "ljjax.fit/1" and found["robot_id"] == "OctRobot-I" and found["version"]
    assert "sigma0 = 1" in found["gauge"]
    assert found["options"] == {"frozen": [], "weights": "equal", "constraints": "none", "seed": 0}
    assert [x["run_id"] for x in found["inputs"]] == list(LOGS)
    assert [(x["steady"], x["probe"], x["partial"]) for x in found["inputs"]] == [(75, 0, None), (0, 9, None)]
    assert all(re.fullmatch(r"[0-9a-f]{64}", x["sha256"]) for x in found["inputs"])
    assert found["parameters"].keys() == UNITS.keys()
    for name, p in found["parameters"].items():
        assert p["unit"] == UNITS[name] and p["reason"]
        fitted = p["source"] in ("steady", "probe")
        assert (p["verdict"] in ("identifiable", "not identifiable")) == fitted == (p["sd"] is not None)
        if fitted:
            low, high = p["ci95"]
            assert low < p["value"] < high and p["sd_over_pressures"] > 0


def test_correlations_are_a_correlation_matrix(octrobot):
    names, matrix = octrobot.json["correlation"]["names"], np.array(octrobot.json["correlation"]["matrix"])
    assert matrix.shape == (len(names), len(names)) == (6, 6)
    np.testing.assert_allclose(np.diag(matrix), 1)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert np.all(np.linalg.eigvalsh(matrix) > 0)
    assert matrix[names.index("gravity.alpha1"), names.index("elastic.c3")] < -0.9


def test_residuals_are_the_measurements_less_the_model(octrobot):
    table = np.genfromtxt(OCTROBOT / "identification.csv", delimiter=",", names=True)
    found = octrobot.json["residuals"]["steady"]
    points = {k: np.array(v) for k, v in found["points"].items()}
    np.testing.assert_allclose(points["measured"], table["force_mean_n"], rtol=1e-12)
    np.testing.assert_allclose(points["sd"], table["force_sd_n"], rtol=1e-12)
    np.testing.assert_allclose(points["pressure_kpa"], table["pressure_kpa"], atol=1e-9)
    np.testing.assert_allclose(np.degrees(points["theta_rad"]), table["theta_deg"], rtol=1e-12)
    v = {k.split(".")[1]: p["value"] for k, p in octrobot.json["parameters"].items()}
    p, th = points["pressure_kpa"], points["theta_rad"]
    alpha2 = v["c1"] * p**2 + v["c2"] * p + v["c3"]
    np.testing.assert_allclose(points["model"], (v["alpha1"] * np.sin(6 * th) + alpha2 * th) / 0.02, rtol=1e-9)
    np.testing.assert_allclose(points["error"], points["measured"] - points["model"], atol=1e-12)
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean(points["error"] ** 2)))
    worst = np.argmax(np.abs(points["error"]))
    assert found["largest"]["error"] == pytest.approx(points["error"][worst])
    assert found["largest"]["pressure_kpa"] == pytest.approx(p[worst])


def test_model_toml_is_the_result(octrobot):
    loaded = modelfile.load(octrobot.folder / "model.toml")
    for name, p in octrobot.json["parameters"].items():
        assert float(get(loaded.model, name)) == p["value"]
    assert loaded.uncertainty == {k: p["sd"] for k, p in octrobot.json["parameters"].items() if p["sd"] is not None}
    assert loaded.model.n == 6 and loaded.frozen == ()
    again = fit(loaded, octrobot.result.runs)
    assert isinstance(again, StaticResult)
    for name in again.static.names:
        assert float(get(again.model, name)) == pytest.approx(octrobot.json["parameters"][name]["value"], rel=1e-6)


class Page(HTMLParser):
    """Tags with their attributes, and the text."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def page(octrobot) -> tuple[str, Page]:
    text = (octrobot.folder / "report.html").read_text(encoding="utf-8")
    return text, Page(text)


def test_the_report_loads_nothing(page):
    text, parsed = page
    sources = [a[k] for _, a in parsed.tags for k in ("src", "href", "srcset", "action", "data") if k in a]
    assert sources and all(s is not None and s.startswith("data:image/svg+xml;base64,") for s in sources)
    assert not {tag for tag, _ in parsed.tags} & {"script", "link", "iframe", "object", "embed"}
    assert not re.search(r"https?:|@import|url\(", text)
    for source in sources:
        root = ElementTree.fromstring(base64.b64decode(str(source).split(",")[1]))
        links = [v for e in root.iter() for k, v in e.attrib.items() if k.split("}")[-1] in ("href", "src")]
        assert all(link.startswith(("#", "data:")) for link in links)


def test_the_report_shows_figures_that_a_screen_reader_can_say(page):
    images = [a for tag, a in page[1].tags if tag == "img"]
    alts = [a.get("alt") or "" for a in images]
    assert len(images) == 8 and len(set(alts)) == 8 and all(len(alt) > 30 for alt in alts)
    for title in (
        "Tension that holds an angle",
        "Tip stiffness",
        "Where the fit is worst",
        "Intervals",
        "Correlations",
    ):
        assert any(alt.startswith(title) for alt in alts)


def test_the_report_says_what_matters_and_suits_a_phone(page):
    text, parsed = page
    for words in (
        "OctRobot-I",
        "75 steady points",
        "gravity.alpha1",
        "not identifiable",
        "110.985",
        "29.1067",
        "Beware",
    ):
        assert words in parsed.text
    assert any(a.get("name") == "viewport" for tag, a in parsed.tags if tag == "meta")
    assert text.index("<img") < text.index("<table") and text.count('class="scroll"') == text.count("<table")


@pytest.fixture(scope="module")
def messages(octrobot) -> list:
    with (octrobot.folder / "result.mcap").open("rb") as stream:
        rows = list(make_reader(stream).iter_messages(log_time_order=False))
    return rows


def test_result_mcap_holds_every_measured_message_unchanged(messages):
    def key(schema, channel, m):
        return channel.topic, schema.name, schema.data, m.log_time, m.publish_time, m.sequence, m.data

    measured = []
    for log in LOGS:
        with (OCTROBOT / f"{log}.mcap").open("rb") as stream:
            measured += [key(*row) for row in make_reader(stream).iter_messages()]
    copied = [key(*row) for row in messages if row[1].topic.startswith("/real/")]
    assert sorted(copied) == sorted(measured) and len(measured) > 300


PAIRS = {"/tendons": ("effort", 75), "/probe": ("effort", 9)}


@pytest.mark.parametrize("topic", PAIRS)
def test_simulated_plus_residual_is_measured_at_the_same_stamps(octrobot, topic):
    field, count = PAIRS[topic]
    found: dict[str, dict[tuple[int, int], np.ndarray]] = {}
    with (octrobot.folder / "result.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, m in reader.iter_decoded_messages(
            topics=[p + topic for p in ("/real", "/sim", "/residual")]
        ):
            stamp = (m.header.stamp.sec, m.header.stamp.nanosec)
            found.setdefault(channel.topic, {})[stamp] = np.array([*m.position, *getattr(m, field)])
    real, sim, residual = (found[p + topic] for p in ("/real", "/sim", "/residual"))
    assert real.keys() == sim.keys() == residual.keys() and len(real) == count
    for stamp, value in real.items():
        np.testing.assert_allclose(sim[stamp] + residual[stamp], value, rtol=1e-9, atol=1e-12)
    assert max(np.abs(x).max() for x in residual.values()) > 1e-3


def test_result_mcap_says_the_same_as_fit_json(octrobot):
    errors = octrobot.json["residuals"]["steady"]["points"]["error"]
    with (octrobot.folder / "result.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        rows = [m.effort[0] for _, _, _, m in reader.iter_decoded_messages(topics=["/residual/tendons"])]
    np.testing.assert_allclose(rows, errors, rtol=1e-12)


def test_the_same_inputs_give_the_same_bytes(octrobot, tmp_path: Path):
    fit(None, read_all([OCTROBOT / f"{log}.mcap" for log in LOGS])).save(tmp_path)
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (octrobot.folder / name).read_bytes(), name


def test_a_fit_with_a_bound_and_a_frozen_parameter_is_written_whole(truth, measured, run_of, tmp_path: Path):
    """NaN inside (what a bound holds has no deviation) becomes null, the pictures cope, the verdicts say it."""
    from ljjax.fit.static import fit_static
    from ljjax.modelfile import ModelFile

    robot = truth(seed=5, alpha1=-0.1)
    steady, probe = measured(robot)
    static = fit_static(robot.model(), steady, probe, frozen=("elastic.c1",), constraints="paper")
    options = {"frozen": ("elastic.c1",), "weights": "equal", "constraints": "paper", "seed": 0}
    result = StaticResult(
        static=static,
        start=ModelFile(robot.model()),
        start_from="the test",
        runs=[run_of()],
        said=["a.mcap: points"],
        options=options,
    )
    parameters = result.as_dict()["parameters"]
    assert parameters["gravity.alpha1"]["verdict"] == "at bound" and parameters["gravity.alpha1"]["sd"] is None
    assert parameters["elastic.c1"]["verdict"] == "frozen" and parameters["elastic.c1"]["value"] == 0.0
    json.dumps(result.as_dict(), allow_nan=False)
    from ljjax.fit.report import report

    page = Page(report(result, result.as_dict())).text
    assert "at bound" in page and "nan" not in page.lower().replace("nanosec", "")


class Later(RuntimeError):
    pass


def test_a_failure_leaves_nothing_new_and_nothing_changed(octrobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    old = tmp_path / "old"
    old.mkdir()
    (old / "fit.json").write_text("mine")

    def fail(*_):
        raise Later("the last of the four cannot be made")

    monkeypatch.setattr("ljjax.fit.result.copy_overlay", fail)
    for out in (old, tmp_path / "new" / "deeper"):
        with pytest.raises(Later):
            octrobot.result.save(out)
    assert [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.rglob("*"))] == ["old", "old/fit.json"]
    assert (old / "fit.json").read_text() == "mine"


def test_a_log_in_the_folder_is_never_replaced(tmp_path: Path):
    """A user's own log may be called result.mcap."""
    log = tmp_path / "result.mcap"
    log.write_bytes((OCTROBOT / "identification.mcap").read_bytes())
    result = fit(None, read_all([log]))
    with pytest.raises(InputError, match="result.mcap: is an input"):
        result.save(tmp_path)
    assert log.read_bytes() == (OCTROBOT / "identification.mcap").read_bytes()
    assert list(tmp_path.iterdir()) == [log]


def test_the_model_it_began_from_is_never_replaced(tmp_path: Path):
    """A fit continued in the same folder must not eat the model it was given."""
    start = tmp_path / "model.toml"
    start.write_bytes((OCTROBOT / "nominal.toml").read_bytes())
    runs = read_all([OCTROBOT / "identification.mcap"])
    with pytest.raises(InputError, match="model.toml: is an input"):
        fit(modelfile.load(start), runs, model_from=str(start)).save(tmp_path)
    assert start.read_bytes() == (OCTROBOT / "nominal.toml").read_bytes()


def test_a_log_that_changed_meanwhile_is_refused(tmp_path: Path):
    log = tmp_path / "log.mcap"
    log.write_bytes((OCTROBOT / "identification.mcap").read_bytes())
    result = fit(None, read_all([log]))
    log.write_bytes((OCTROBOT / "steady_tension.mcap").read_bytes())
    with pytest.raises(InputError, match="log.mcap: changed since it was read"):
        result.save(tmp_path / "out")
    assert list(tmp_path.iterdir()) == [log]
