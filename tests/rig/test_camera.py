"""The tag: drawn, found, and watched by a process of its own."""

import math
import threading
import time

import numpy as np
import pytest

from ljjax.errors import InputError
from ljjax.rig.camera import TagCamera
from ljjax.rig.emulator.tag import TagPainter, View
from ljjax.rig.eye import Eye, TagFinder
from ljjax.rig.frames import Frame, FrameReader, FrameWriter, open_source
from ljjax.rig.robot import RigError
from tests.rig.emulated import PATIENCE_S, close, until


def table(path, **more):
    return {"source": f"file:{path}", "segments": 2, "wait_s": PATIENCE_S} | more


def test_the_tag_drawn_is_found_with_its_place_and_angle():
    painter, eye, finder = TagPainter(seed=1), Eye(0), TagFinder(0)
    errors = []
    for k, angle in enumerate(np.linspace(-2.5, 2.5, 60)):
        x, y = 320 + 100 * math.sin(angle), 250 + 50 * math.cos(angle)
        picture = painter.paint(x, y, float(angle))
        seen = finder.find(picture)
        if seen is not None:  # from place to place it may jump out of the region that is searched
            assert math.hypot(seen.x - x, seen.y - y) < 1.5 and close(seen.size, 8 * painter.cell_px, 1.0)
        errors.append(eye.look(Frame(k, picture)) - angle)
    assert np.sqrt(np.nanmean(np.square(errors))) < 0.0008 and np.nanmax(np.abs(errors)) < 0.004  # rad, of q_Σ
    assert np.mean(np.isnan(errors)) < 0.5
    assert TagFinder(1).find(painter.paint(320, 200, 0.0)) is None  # another tag


def test_a_tag_that_is_followed_may_turn_beyond_half_a_turn():
    painter, eye = TagPainter(), Eye(0)
    angles = np.linspace(0, 4.5, 46)
    found = [eye.look(Frame(k, painter.paint(320, 200, float(a)))) for k, a in enumerate(angles)]
    assert np.nanmax(np.abs(np.array(found) - angles)) < 0.02


def test_the_view_is_that_of_the_body():
    view = View(2, 0.05)
    x, y, angle = view.tip((0.0, 0.0))
    assert angle == 0 and x == 320 and y > 300
    right, _, turned = view.tip((0.2, 0.2))
    assert right > x and turned == pytest.approx(0.4)  # the left tendon is at the right, and the turn counter-clockwise


def test_pictures_go_through_a_file(tmp_path):
    writer = FrameWriter(tmp_path / "pictures", 6, 4, slots=3)
    reader = FrameReader(str(tmp_path / "pictures"))
    assert reader.grab(0.0) is None
    for k in range(5):
        writer.put(Frame(float(k), np.full((4, 6), k, np.uint8)))
    frame = reader.grab(0.0)
    assert frame is not None and frame.stamp == 4.0 and frame.picture.shape == (4, 6) and np.all(frame.picture == 4)
    assert reader.grab(0.0) is None  # none twice
    reader.close()
    writer.close()


def test_the_camera_tells_shape_loss_and_frost(tmp_path):
    painter = TagPainter()
    writer = FrameWriter(tmp_path / "pictures", painter.width, painter.height)

    def show(picture):
        writer.put(Frame(time.monotonic(), picture))

    camera = TagCamera(table(tmp_path / "pictures", zero_rad=0.1, sign=-1))
    with pytest.raises(RigError, match="no picture in 0.2 s"):
        TagCamera(table(tmp_path / "pictures", wait_s=0.2)).connect()
    ending = threading.Event()

    def feed_it():
        while not ending.wait(0.02):
            show(painter.paint(320, 300, 0.3))

    feed = threading.Thread(target=feed_it)
    feed.start()
    try:
        camera.connect()
        until(lambda: close(camera.read().theta, (-0.3 - 0.1) / 2, 0.01))
        ending.set()
        feed.join()
        begun = camera.read().t
        until(lambda: math.isnan(camera.read().theta), lambda: show(painter.blank()))
        assert camera.read().t > begun
        until(lambda: close(camera.read().theta, -0.2, 0.01), lambda: show(painter.paint(100, 100, 0.3)))  # elsewhere
        still = painter.paint(100, 100, 0.35)
        until(lambda: close(camera.read().theta, -0.225, 0.01), lambda: show(still))
        begun, end = camera.read().t, time.monotonic() + 0.5
        until(lambda: time.monotonic() > end, lambda: show(still))
        assert camera.read().t == begun  # the same picture to the last bit is none
        assert camera._process is not None
        camera._process.kill()
        until(lambda: camera.read().faults)
        assert "process has ended" in camera.read().faults[0]
    finally:
        ending.set()
        feed.join()
        camera.stop()
        writer.close()
    camera.stop()
    assert math.isnan(camera.read().theta)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("file:/nowhere", "start the emulator"),
        ("nobody.knows:this", "expected file:PATH"),
        ("opencv:0", "opencv|OpenCV"),
    ],
)
def test_a_source_that_is_not_there_is_named(source, said):
    with pytest.raises(RigError, match=said):
        open_source(source, 640, 400, 210.0)


def test_what_the_process_says_is_what_connect_raises():
    camera = TagCamera({"source": "file:/nowhere", "segments": 2, "wait_s": PATIENCE_S})
    with pytest.raises(RigError, match="camera.source file:/nowhere: .*No such file"):
        camera.connect()


@pytest.mark.parametrize(
    ("change", "said"),
    [({"segments": 0}, "camera.segments"), ({"sign": "left"}, "camera.sign"), ({"x": 1}, "camera.x")],
)
def test_a_wrong_key_is_named(change, said):
    with pytest.raises(InputError, match=said):
        TagCamera(table("a") | change)
