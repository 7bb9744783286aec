"""What symbols say beside their characters: identifiers, character sets, ECI, parts of messages, GS1."""

import itertools
import sys

import numpy as np
import pytest
import segno
import zxingcpp
from hypothesis import given, settings
from hypothesis import strategies as st
from segno import consts

from evqr.config import DecodeConfig
from evqr.symbol import micro_qr, qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.gs1 import NOT_INSTALLED, elements_of
from evqr.symbol.messages import join_messages
from evqr.symbol.payload import CharsetSource, ContentType, Payload, StructuredAppend
from evqr.symbol.qr_segments import segments_of

BYTE, KANJI = consts.MODE_BYTE, consts.MODE_KANJI


def payload_of(symbol, charset=None):
    grid = np.where(np.array(getattr(symbol, "matrix", symbol), dtype=bool), -1, 1)
    size = len(grid)
    space = qr.space(qr.version_of(size)) if size > 17 else micro_qr.space(f"M{(size - 9) // 2}")
    outcome = decode_grid(grid, space, config=DecodeConfig(charset=charset))
    assert isinstance(outcome, Decoded), outcome
    return outcome.payload


def make(content, **options):
    return segno.make(content, **{"micro": False, **options})


def zxing(content, **options):
    code = zxingcpp.create_barcode(content, zxingcpp.BarcodeFormat.QRCode, **options)
    return np.array(code.to_image(scale=1, add_quiet_zones=False)) < 128


ECI, MODE, ASSUMED, GUESSED = (
    CharsetSource.ECI,
    CharsetSource.MODE,
    CharsetSource.ASSUMED,
    CharsetSource.GUESSED,
)


@pytest.mark.parametrize(
    ("symbol", "text", "charset", "source"),
    [
        (make("LOT 42"), "LOT 42", "ascii", MODE),
        (make("lot 42"), "lot 42", "ascii", GUESSED),
        (make("漢字", mode="kanji"), "漢字", "shift_jis", MODE),
        (make("漢字", mode="kanji", micro=True), "漢字", "shift_jis", MODE),
        (make("né", encoding="latin-1", micro=True), "né", "iso8859-1", GUESSED),
        (make("né", encoding="latin-1"), "né", "iso8859-1", GUESSED),
        (make("né", encoding="utf-8"), "né", "utf-8", GUESSED),
        (make("né", encoding="utf-8", eci=True), "né", "utf-8", ECI),
        (make("né", encoding="iso8859-15", eci=True), "né", "iso8859-15", ECI),
        (make([("77",), ("漢字", KANJI), ("A:B",)]), "77漢字A:B", "shift_jis", MODE),
        (make("12345", version="M1", micro=True), "12345", "ascii", MODE),
    ],
)
def test_where_the_character_set_is_known_from(symbol, text, charset, source):
    payload = payload_of(symbol)
    assert (payload.text, payload.charset, payload.charset_source) == (text, charset, source)
    assert payload.symbology_identifier == "]Q1"
    assert payload.content_type is ContentType.TEXT
    assert bool(payload.eci) == (source is ECI)
    assert payload.structured_append is None and not payload.gs1 and not payload.warnings


def test_a_character_set_is_assumed_where_none_is_named():
    russian = make("Привет", encoding="cp1251")
    assert payload_of(russian).charset_source is GUESSED
    payload = payload_of(russian, charset="windows-1251")
    assert (payload.text, payload.charset_source) == ("Привет", ASSUMED)
    named = payload_of(make("né", encoding="utf-8", eci=True), charset="cp1251")
    assert (named.text, named.charset_source) == ("né", ECI)
    # a mode that names its own keeps it, beside bytes that do not
    mixed = make([("漢字", KANJI), ("né", BYTE, "utf-8"), ("77",)])
    assert payload_of(mixed, charset="utf-8").text == "漢字né77"
    wide = payload_of(make("Ж", encoding="utf-16-le"), charset="utf-16-le")
    assert (wide.text, wide.content_type) == ("Ж", ContentType.TEXT)
    wrong = payload_of(make("né", encoding="latin-1"), charset="utf-8")
    assert wrong.text == "n\N{REPLACEMENT CHARACTER}" and "utf-8" in wrong.warnings[0]


@pytest.mark.parametrize(("eci", "data"), [(1000, b"\xff\xfe\x00h"), (899999, b"\\000026"), (100, b"abc")])
def test_content_in_an_unknown_eci_is_shown_as_its_bytes(eci, data):
    payload = payload_of(zxing(data, eci=eci))
    assert payload.content_type is ContentType.UNKNOWN_ECI
    assert payload.eci == (eci,) and payload.charset is None
    assert payload.text.encode("latin-1") == payload.data == data


def test_binary_content():
    payload = payload_of(zxing(b"\xff\xfe\x00\\h", eci=899))
    assert (payload.content_type, payload.eci) == (ContentType.BINARY, (899,))
    assert payload.text.encode("latin-1") == payload.data == b"\xff\xfe\x00\\h"
    guessed = payload_of(make(b"\x00\x01\xff\xfe", mode="byte", encoding="latin-1"))
    assert (guessed.content_type, guessed.eci) == (ContentType.BINARY, ())
    assert guessed.data == b"\x00\x01\xff\xfe"


def test_gs1_is_told_from_the_same_characters():
    pytest.importorskip("biip")
    marked = payload_of(zxing("(01)09506000134352(10)AB%C(21)X", gs1=True))
    plain = payload_of(make("010950600013435210AB%C\x1d21X"))
    assert marked.data == plain.data and not marked.same_content(plain)
    assert (marked.symbology_identifier, plain.symbology_identifier) == ("]Q3", "]Q1")
    assert (marked.content_type, plain.gs1) == (ContentType.GS1, ())
    assert [str(each) for each in marked.gs1] == [
        "(01) GTIN 09506000134352",
        "(10) BATCH/LOT AB%C",
        "(21) SERIAL X",
    ]
    assert not marked.gs1_error


def test_gs1_that_does_not_parse_is_told_raw():
    pytest.importorskip("biip")
    payload = Payload(text="66", data=b"66", symbology_identifier="]Q3", content_type=ContentType.GS1)
    assert payload.gs1 == () and "elements cannot be told apart" in payload.gs1_error


def test_gs1_without_the_extra_says_how_to_get_elements(monkeypatch):
    elements_of.cache_clear()
    monkeypatch.setitem(sys.modules, "biip", None)
    elements, why_not = elements_of("0109506000134352")
    assert not elements and why_not.startswith(NOT_INSTALLED) and "[gs1]" in why_not
    elements_of.cache_clear()


# ---- structured append


def sequence(text, **options):
    return [payload_of(symbol) for symbol in segno.make_sequence(text, **options)]


@given(st.text(st.characters(max_codepoint=0x7E), min_size=2, max_size=60), st.integers(2, 6))
@settings(max_examples=25, deadline=None)
def test_segments_cover_the_content(text, count):
    """Lengths by mode add up to what zxing-cpp gives, and the header says what was written."""
    if len(text) < count:
        return
    parts = sequence(text, symbol_count=count)
    assert [part.structured_append.index for part in parts] == list(range(count))
    assert {(part.structured_append.count, part.structured_append.parity) for part in parts} == {
        (count, np.bitwise_xor.reduce(np.frombuffer(text.encode(), np.uint8)))
    }
    (message,) = join_messages(parts[::-1])
    assert (message.text, message.parity_agrees) == (text, True)


@given(st.binary(max_size=40), st.sampled_from([1, 12, 30, "M1", "M2", "M3", "M4"]))
def test_no_data_is_too_odd(data, version):
    runs = segments_of(data, version).runs
    assert all(run.length > 0 for run in runs)
    assert all(one.charset != other.charset for one, other in itertools.pairwise(runs))


def part(data, index, count, parity, **changes):
    append = StructuredAppend(index=index, count=count, parity=parity)
    return Payload(
        text=data.decode("latin-1"),
        data=data,
        symbology_identifier="]Q1",
        structured_append=append,
        **changes,
    )


def parts_of(data, count, parity=None):
    """Cut into equal parts."""
    parity = int(np.bitwise_xor.reduce(np.frombuffer(data, np.uint8))) if parity is None else parity
    cuts = np.linspace(0, len(data), count + 1).round().astype(int)
    return [part(data[a:b], k, count, parity) for k, (a, b) in enumerate(itertools.pairwise(cuts))]


@given(st.permutations(range(9)))
def test_messages_are_joined_in_any_order_with_repeats(order):
    passed = [*parts_of(b"first one", 3), *parts_of(b"second message", 4)[:2], *parts_of(b"third", 2)]
    passed = [(passed + passed[:2])[k] for k in order]
    found = {message.count: message for message in join_messages([Payload(text="x", data=b"x"), *passed])}
    assert (found[3].text, found[3].data, found[3].missing) == ("first one", b"first one", ())
    assert (found[2].text, found[2].complete) == ("third", True)
    assert (found[4].text, found[4].missing, len(found[4].parts)) == (None, (2, 3), 2)
    assert "missing: 3, 4" in str(found[4])


@given(st.permutations(range(6)))
def test_messages_of_one_parity_are_not_mixed(order):
    one, other = b"abcdef", b"pqrstu"
    parity = int(np.bitwise_xor.reduce(np.frombuffer(one, np.uint8)))
    other += bytes([int(np.bitwise_xor.reduce(np.frombuffer(other, np.uint8))) ^ parity])
    passed = [*parts_of(one, 3), *parts_of(other, 3)]
    messages = join_messages([passed[k] for k in order])
    assert {message.data for message in messages} == {one, other}
    assert all(message.parity_agrees for message in messages)


def test_parts_of_different_parity_or_count_are_never_joined():
    first, second = part(b"ab", 0, 2, 3), part(b"cd", 1, 2, 4)
    third = part(b"cd", 1, 3, 3)
    assert [message.text for message in join_messages([first, second, third])] == [None, None, None]
    (odd,) = join_messages([first, part(b"xy", 1, 2, 3)])
    assert odd.parity_agrees is False and "another parity" in str(odd)


def test_a_character_that_is_cut_between_parts_is_whole_again():
    parts = parts_of("€uro".encode(), 2)
    assert "€" not in parts[0].text
    cut = [part(b"\xe2\x82", 0, 2, 0), part(b"\xac5", 1, 2, 0, charset="cp932")]
    (message,) = join_messages(cut)
    assert message.text == "€5"
