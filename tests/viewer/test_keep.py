"""What is kept of a session: names, pictures, recorded paths; what fails is told in words."""

from __future__ import annotations

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.conftest import gaussians
from tests.viewer import rules
from tests.viewer.rules import VIEW, camera_at
from tsplat.core.camera import look_at
from tsplat.core.errors import PluginError
from tsplat.io.cameras import load_camera
from tsplat.paths import load_path
from tsplat.plan import make_plan
from tsplat.viewer.engine import Prepared
from tsplat.viewer.keep import Keeper, Recording, free_name
from tsplat.viewer.look import Look

SCENE = replace(gaussians([(0, 0, 0), (0.5, 0.2, 1)], scales=0.4), name="two.ply")


def prepared(scene=SCENE, run=None):
    plan = make_plan(scene, backend="numpy")
    if run is not None:
        plan = replace(plan, stages=replace(plan.stages, project=run), fused=None)
    return Prepared(scene, plan, Look())


def command(view, camera, picture, pose):
    return f"make {picture} {pose}"


def keep(folder, view=VIEW, made=None):
    """A keeper after one picture, and what it told."""
    keeper, told = Keeper(command, folder), []
    camera = view.camera((32, 24), (1.0, 1.0))
    keeper.picture(view, camera, made or prepared(), told.append)
    keeper.wait()
    return keeper, told


@pytest.mark.parametrize("rule", [r for rows in rules.KEPT_RULES.values() for r in rows],
                         ids=lambda rule: rule.__name__)  # fmt: skip
def test_what_is_kept(rule):
    """What the rule says holds."""
    rule(Recording if rule in rules.KEPT_RULES["recording"] else free_name)


def test_names_are_not_taken_twice_at_once(tmp_path):
    """Threads that ask at the same time get different ones."""
    names, start = [], threading.Barrier(8)

    def ask():
        start.wait()
        for _ in range(10):
            names.append(free_name(tmp_path, "a", ".png", ".json"))

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(names)) == 80


def test_a_picture_is_written_and_told(tmp_path):
    """On the background that is seen, of the size that was asked for."""
    view = VIEW.looking(background=(0.0, 1.0, 0.0))
    keeper, told = keep(tmp_path, view)
    assert told == ["tsplat-two-001.png, 32x24"]
    assert keeper.said == ["tsplat-two-001.png: make tsplat-two-001.png None"]
    image = np.asarray(Image.open(tmp_path / "tsplat-two-001.png").convert("RGB"))
    frame = prepared().plan.run(SCENE, view.camera((32, 24), (1.0, 1.0))).frame
    np.testing.assert_array_equal(image, frame.over(view.look.background).to_uint8())
    assert image[0, 0, 1] > 250
    assert [path.name for path in tmp_path.iterdir()] == ["tsplat-two-001.png"]


def test_a_camera_that_options_cannot_say_is_written_beside(tmp_path):
    """A file's camera, a place on a path, straight down: all bits of it."""
    tilted = look_at((1, -2, -6), (0, 0, 0), (0.3, -1, 0), 35, 32, 24)
    poles = replace(VIEW, orbit=replace(VIEW.orbit, pitch=np.pi / 2))
    for number, view in enumerate((VIEW.at(tilted), poles), 1):
        keeper, _ = keep(tmp_path, view)
        name = f"tsplat-two-{number:03d}.json"
        assert keeper.said[0].endswith(name)
        assert load_camera(str(tmp_path / name)).same(view.camera((32, 24), (1.0, 1.0)))


def test_what_fails_is_told_and_leaves_nothing(tmp_path):
    """No folder, a file for a folder, a backend that raises whatever it likes."""
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "none", tmp_path / "file"):
        keeper, told = keep(folder)
        assert told[0].startswith("no picture: ")
        assert not keeper.said
    (tmp_path / "empty").mkdir()
    for error in (PluginError("out of order"), ZeroDivisionError("by zero"), MemoryError()):

        def fails(*arguments, error=error):
            raise error

        keeper, told = keep(tmp_path / "empty", made=prepared(run=fails))
        assert told == [f"no picture: {str(error) or 'MemoryError'}"]
        assert not keeper.said
    assert not list((tmp_path / "empty").iterdir())


def test_several_pictures_are_all_written(tmp_path):
    """Asked for before the first is done; waiting is for all."""
    keeper, told = Keeper(command, tmp_path), []
    for place in range(5):
        keeper.picture(VIEW, camera_at(place), prepared(), told.append)
    keeper.wait()
    assert len(told) == len(list(tmp_path.glob("tsplat-two-*.png"))) == len(keeper.said) == 5
    assert all(path.stat().st_size for path in tmp_path.iterdir())


def test_a_path_is_written_and_told(tmp_path):
    """With its seconds; it can be loaded."""
    recording = Recording()
    for time in (5.0, 5.5, 7.5):
        recording.add(time, camera_at(time))
    keeper = Keeper(command, tmp_path)
    assert keeper.path(recording, "my scene.ply") == "tsplat-my-scene-path-001.json, 2.5 s"
    assert load_path(tmp_path / "tsplat-my-scene-path-001.json").seconds == 2.5
    assert "2.5 s" in keeper.said[0]


def test_a_path_that_cannot_be_is_told(tmp_path):
    """Nothing recorded, one moment only, or no place to write to."""
    recording = Recording()
    keeper = Keeper(command, tmp_path / "none")
    assert keeper.path(recording, "a").startswith("no path: ")
    recording.add(1.0, camera_at(1.0))
    assert keeper.path(recording, "a") == "no path: the camera did not move"
    recording.add(2.0, camera_at(2.0))
    assert keeper.path(recording, "a") == "no path: No such file or directory"
    assert not keeper.said


def test_a_rest_is_two_poses():
    """However long, and however often it is looked at; its first moment and its last."""
    recording = Recording()
    for time in (0.0, 0.5, 1.0):
        recording.add(time, camera_at(time))
    for time in np.linspace(1.05, 60, 300):
        recording.add(float(time), camera_at(1.0))
    recording.add(60.2, camera_at(2.0))
    assert [t for t, _ in recording.poses] == [0.0, 0.5, 1.0, 60.0, 60.2]
    times = [pose["time"] for pose in json.loads(recording.text())]
    assert times == [0.0, 0.5, 1.0, 60.0, 60.2]


def test_the_last_place_of_a_move_is_kept():
    """Less than the usual time after the one before, when nothing comes for a long time after."""
    recording = Recording()
    for time in (0.0, 0.1, 0.2, 0.25):
        recording.add(time, camera_at(time))
    recording.add(30.0, camera_at(0.25))
    assert recording.poses[-2][0] == 0.25
    assert recording.poses[-2][1].same(recording.poses[-1][1])
