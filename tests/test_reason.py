"""Why nothing was read: codes for programs, texts for people."""

import json
import pickle

import pytest

from evqr.reason import Reason


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_has_a_code_and_a_text(reason):
    assert reason.value == reason.name.lower()
    assert reason.text.strip() == reason.text != ""
    assert "\n" not in reason.text and not reason.text.endswith(".")


def test_texts_differ():
    assert len({reason.text for reason in Reason}) == len(Reason)


def test_a_reason_is_its_code_wherever_it_goes():
    reason = Reason.POSSIBLY_CHANCE
    assert Reason("possibly_chance") is reason
    assert pickle.loads(pickle.dumps(reason)) is reason
    assert json.dumps(reason) == '"possibly_chance"'
    assert f"{reason}" == str(reason) == "possibly_chance"


def test_a_detail_follows_the_text():
    assert Reason.NOTHING_MOVES.explained() == "nothing moves"
    assert Reason.POSSIBLY_CHANCE.explained("1 of 2") == "possibly chance: 1 of 2"
