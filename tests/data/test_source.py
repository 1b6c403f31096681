"""Sources by their names."""

import pytest

from helpers.categories import LAPTOP
from omad.common.errors import InputError
from omad.data.source import is_generated, load_models, load_objects


def test_what_is_to_test_on_is_no_training_split():
    models = load_models("unusual", LAPTOP, 2, "test", 0).models
    assert len({model.name for model in models}) == 2
    for load in (
        lambda: load_models("unusual", LAPTOP, 2, "train", 0),
        lambda: load_objects("unusual", LAPTOP, 2, "train", 0, "refuse"),
    ):
        with pytest.raises(InputError, match="unusual: its objects are the same in each split"):
            load()


def test_generators_make_as_many_objects_as_one_likes_and_folders_do_not(tmp_path):
    assert [is_generated(name) for name in ("procedural", "unusual", "mirrored", "own.py")] == [True] * 4
    assert [is_generated(name) for name in (str(tmp_path), "laptop")] == [False] * 2
