"""Quick questions: what they say they answer by default is what they answer."""

import dataclasses
import inspect
import re

import numpy as np

import graceful_plan as gp


def test_the_default_interaction_model_is_the_one_that_is_stated():
    stated = re.search(
        r'by default "(\w+)".*ImpactCost` is\s+another one, "(\w+)"', str(gp.interaction_probability.__doc__)
    )
    default = inspect.signature(gp.interaction_probability).parameters["model"].default
    (costs,) = (field.default for field in dataclasses.fields(gp.ImpactCost) if field.name == "model")
    assert stated is not None and stated.groups() == (default, costs)
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    q = np.linspace(task.start, task.goal[0], 20)
    P = gp.interaction_probability(task.scene, q)
    np.testing.assert_array_equal(P, gp.interaction_probability(task.scene, q, default))
    assert not np.array_equal(P, gp.interaction_probability(task.scene, q, costs))
