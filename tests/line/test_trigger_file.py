"""Triggers from a file: what is read, and what is said of what cannot be."""

import pytest

from evqr.errors import UsageError
from evqr.line.gates import Trigger, TriggerKind
from evqr.line.trigger_file import read_triggers


def of(tmp_path, text):
    path = tmp_path / "gates.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_triggers(path)


def test_columns_may_be_left_out_and_empty(tmp_path):
    text = "t_us,kind,index,ticks\n10,start,3\n20,end,3,\n15,pulse\n\n25,pulse,,7.5\n30,ticks,,9\n"
    assert of(tmp_path, text) == [
        Trigger(10, TriggerKind.START, 3),
        Trigger(15, TriggerKind.PULSE),
        Trigger(20, TriggerKind.END, 3),
        Trigger(25, TriggerKind.PULSE, None, 7.5),
        Trigger(30, TriggerKind.TICKS, None, 9.0),
    ]


def test_no_head_is_needed_and_a_mark_of_byte_order_does_no_harm(tmp_path):
    assert of(tmp_path, b"\xef\xbb\xbf5,pulse\r\n6,pulse\r\n") == [Trigger(5), Trigger(6)]
    assert of(tmp_path, "") == of(tmp_path, "t_us,kind\n") == []


def test_those_of_one_time_keep_their_order(tmp_path):
    found = of(tmp_path, "9,end,1\n5,start,1\n9,start,2\n")
    assert [(each.t_us, each.index) for each in found] == [(5, 1), (9, 1), (9, 2)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_us,kind\n5,begin\n", "line 2: kind 'begin' is none of pulse, start, end, ticks"),
        ("5.5,pulse\n", "line 1: t_us '5.5' is no number"),
        (",pulse\n", "line 1: t_us is missing"),
        ("5\n", "line 1: 1 columns"),
        ("5,pulse,1,2,3\n", "line 1: 5 columns"),
        ("5,pulse,x\n", "line 1: index 'x' is no number"),
        ("5,pulse,1,nan\n", "line 1: ticks 'nan' is no number"),
        (b"\xff\xfe5\x00", "is no text of t_us,kind,index,ticks"),
    ],
)
def test_what_is_no_trigger_is_refused(tmp_path, text, said):
    with pytest.raises(UsageError) as caught:
        of(tmp_path, text)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(UsageError, match=r"gates\.csv: cannot be read \(No such file"):
        read_triggers(tmp_path / "gates.csv")
