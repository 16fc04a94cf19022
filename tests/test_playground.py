"""The peer's rate in examples/playground.py: from the times at which Brax's learner
reports, of Playground's Go1 without what is only seen."""

import itertools
import xml.etree.ElementTree as ET

import pytest

playground = pytest.importorskip("playground", exc_type=ImportError)


def test_the_go1_has_its_masses_and_contacts_without_its_meshes():
    model = playground.make_env("jax").mj_model
    from mujoco_playground._src.locomotion.go1 import go1_constants

    root = ET.parse(go1_constants.ROOT_PATH / "xmls" / "go1_mjx_feetonly.xml").getroot()
    masses = [float(inertial.get("mass", "nan")) for inertial in root.iter("inertial")]
    assert (model.nq, model.nv, model.nu, model.nmesh) == (19, 18, 12, 0)
    assert model.body_mass.sum() == pytest.approx(sum(masses))
    assert {"FR", "FL", "RR", "RL"} <= {model.geom(i).name for i in range(model.ngeom)}


def test_what_is_only_seen_goes():
    text = b"<mujoco><asset><mesh file='a.stl'/><texture/></asset><body><geom mesh='a'/><geom size='1'/></body></mujoco>"
    assert [
        element.tag for element in ET.fromstring(playground.without_meshes(text)).iter()
    ] == ["mujoco", "asset", "texture", "body", "geom"]


@pytest.fixture
def learner(monkeypatch):
    """Replace Brax's learner by one that reports at set times; return the settings that
    it was given."""
    asked = {"looks": 0}
    now = itertools.chain((100.0, 130.0), itertools.count(140.0, 10.0))

    def train(environment, *, progress_fn, **settings):
        asked.update(settings)
        for look in range(settings["num_evals"] - 1):
            asked["looks"] += 1
            progress_fn(look, {})

    monkeypatch.setattr(playground.ppo_train, "train", train)
    monkeypatch.setattr(playground, "make_env", lambda impl: None)
    monkeypatch.setattr(playground.time, "perf_counter", lambda: next(now))
    return asked


@pytest.mark.parametrize(
    ("seconds", "spans"), [(0.01, 2), (20.0, 2), (25.0, 3), (95.0, 10)]
)
def test_what_compiles_is_not_timed_and_the_rest_as_long_as_asked(
    learner, seconds, spans
):
    rate = playground.measure_playground(64, seconds)
    # Spans of 10 s, five train steps each of 64 robots for 20 control steps.
    assert learner["looks"] - playground.WARM_UP == spans
    assert rate == pytest.approx(5 * 64 * 20 / 10.0)
    assert learner["batch_size"] * learner["num_minibatches"] == learner["num_envs"]
    assert learner["num_envs"] == 64
    # Brax makes train steps of this many control steps, so many between two looks:
    # five.
    assert learner["num_timesteps"] == (learner["num_evals"] - 1) * 5 * 64 * 20
    assert learner["num_updates_per_batch"] == 4


def test_playgrounds_own_number_of_robots_is_the_default(learner):
    playground.measure_playground()
    assert learner["num_envs"] == 8192
    assert learner["batch_size"] == 256


def test_robots_that_do_not_fill_the_minibatches_are_refused():
    with pytest.raises(
        SystemExit, match=r"63 robots: .* needs a multiple of its 32 minibatches"
    ):
        playground.measure_playground(63)
