"""Every kind of payload, simulated and read."""

import numpy as np
import pytest
import scenes

import evqr
from evqr.errors import UsageError
from evqr.simulate import CodePlacement, simulate
from evqr.simulate.printed import make_symbol, parts_of_a_message
from evqr.simulate.qr_writer import gs1_message, write_qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.messages import join_messages
from evqr.symbol.payload import CharsetSource, ContentType, StructuredAppend

BINARY = "\x00\x01\xfe\xff"
GS1 = "(01)09506000134352(10)LOT%7(21)X"


def grid_of(**options):
    return decoded(make_symbol(CodePlacement(**options)))


def decoded(symbol):
    outcome = decode_grid(1.0 - 2.0 * symbol.modules, symbol.space)
    assert isinstance(outcome, Decoded), outcome
    return outcome.payload


KINDS = [
    ({"text": "héllo", "charset": "latin-1"}, b"h\xe9llo", ContentType.TEXT, CharsetSource.GUESSED),
    ({"text": "héllo", "charset": "utf-8"}, b"h\xc3\xa9llo", ContentType.TEXT, CharsetSource.GUESSED),
    ({"text": "héllo", "eci": 26}, b"h\xc3\xa9llo", ContentType.TEXT, CharsetSource.ECI),
    ({"text": "漢字"}, "漢字".encode("shift_jis"), ContentType.TEXT, CharsetSource.MODE),
    (
        {"text": BINARY, "charset": "latin-1"},
        BINARY.encode("latin-1"),
        ContentType.BINARY,
        CharsetSource.GUESSED,
    ),
    ({"text": BINARY, "eci": 899}, BINARY.encode("latin-1"), ContentType.BINARY, CharsetSource.ECI),
    ({"text": "abc", "eci": 123456}, b"abc", ContentType.UNKNOWN_ECI, CharsetSource.ECI),
    ({"text": GS1, "gs1": True}, b"010950600013435210LOT%7\x1d21X", ContentType.GS1, CharsetSource.MODE),
    ({"text": "(10)lot 7", "gs1": True}, b"10lot 7", ContentType.GS1, CharsetSource.GUESSED),
    ({"text": "A%B", "application": "37"}, b"37A%B", ContentType.TEXT, CharsetSource.MODE),
    ({"text": "lot 7", "application": "a"}, b"alot 7", ContentType.TEXT, CharsetSource.GUESSED),
    ({"text": "hé", "application": "05", "eci": 26}, b"05h\xc3\xa9", ContentType.TEXT, CharsetSource.ECI),
    (
        {"text": GS1, "gs1": True, "eci": 26},
        b"010950600013435210LOT%7\x1d21X",
        ContentType.GS1,
        CharsetSource.ECI,
    ),
    (
        {"text": "né", "charset": "latin-1", "symbology": "MicroQRCode"},
        b"n\xe9",
        ContentType.TEXT,
        CharsetSource.GUESSED,
    ),
    (
        {"text": "漢字", "symbology": "MicroQRCode"},
        "漢字".encode("shift_jis"),
        ContentType.TEXT,
        CharsetSource.MODE,
    ),
]


@pytest.mark.parametrize(("options", "data", "kind", "source"), KINDS)
def test_what_is_printed_is_what_is_decoded(options, data, kind, source):
    payload = grid_of(**options)
    assert (payload.data, payload.content_type, payload.charset_source) == (data, kind, source)
    assert payload.text == options.get("application", "") + CodePlacement(**options).text
    identifier = "]Q3" if kind is ContentType.GS1 else "]Q5" if "application" in options else "]Q1"
    assert payload.symbology_identifier == identifier
    assert payload.eci == ((options["eci"],) if "eci" in options else ())


@pytest.mark.parametrize(("options", "data", "kind", "source"), [*KINDS[1:5], *KINDS[6:10]])
def test_what_is_simulated_is_what_is_read(options, data, kind, source):
    made = scenes.scene(**{"version": None, "width": 240, "height": 200, "module_px": 4.0, **options})
    (reading,) = evqr.read_codes(made.events, threads=1).readings
    assert (reading.data, reading.content_type, reading.charset_source) == (data, kind, source)
    assert reading.text == made.truth["truth"]["payload"]


def test_a_message_of_three_codes_is_joined():
    """Side by side, so that they do not pass in their order."""
    options = {"version": 1, "module_px": 3.5, "angle": 20.0}
    parts = parts_of_a_message([CodePlacement(text=text, **options) for text in ("one ", "two ", "three")])
    places = ((130.0, 0.0), (-130.0, 0.0), (0.0, 0.0))
    codes = tuple(
        CodePlacement(**{**vars(part), "offset_px": place}) for part, place in zip(parts, places, strict=True)
    )
    made = scenes.scene(codes=codes, width=400, height=300)
    result = evqr.read_codes(made.events, threads=1)
    assert sorted(str(reading.structured_append) for reading in result.readings) == [
        f"part {k} of 3, parity {parts[0].append.parity}" for k in (1, 2, 3)
    ]
    (message,) = result.messages
    assert (message.text, message.complete, message.parity_agrees) == ("one two three", True, True)
    assert result.to_dict()["messages"][0]["text"] == "one two three"


@pytest.mark.parametrize("version", [1, 10, 27])
@pytest.mark.parametrize("mask", [None, 5])
def test_symbols_of_all_kinds_at_once(version, mask):
    """ECI, part of a message, FNC1 and characters of several bytes, in all ranges of lengths."""
    append = StructuredAppend(index=3, count=16, parity=255)
    code = write_qr(
        "aé", version=version, level="L", mask=mask, gs1=True, eci=26, charset=None, append=append
    )
    assert int(code.version) == version and code.mask in (range(8) if mask is None else [mask])
    grid = 1.0 - 2.0 * np.array(code.matrix)
    space = make_symbol(CodePlacement(text="a", version=version)).space
    outcome = decode_grid(grid, space)
    assert isinstance(outcome, Decoded)
    payload = outcome.payload
    assert (payload.text, payload.structured_append) == ("aé", append)
    assert (payload.symbology_identifier, payload.eci) == ("]Q3", (26,))


@pytest.mark.parametrize("charset", [None, "utf-8", "shift_jis"])
def test_parity_is_of_the_bytes_that_are_written(charset):
    placements = [CodePlacement(text=text, charset=charset) for text in ("漢字", "ab", "字")]
    parts = [decoded(make_symbol(part)) for part in parts_of_a_message(placements)]
    (message,) = join_messages(parts)
    assert (message.text, message.parity_agrees) == ("漢字ab字", True)


def test_gs1_messages_are_written_with_the_separators_that_they_need():
    assert gs1_message("(10)A(01)09506000134352(21)B") == "10A\x1d010950600013435221B"
    assert gs1_message("10A\x1d21B") == "10A\x1d21B"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"gs1": True, "symbology": "MicroQRCode"},
            "gs1 is True, but must be left out: MicroQRCode has none",
        ),
        ({"eci": 26, "symbology": "MicroQRCode"}, "eci is 26, but must be left out"),
        ({"application": "7"}, "application is '7', but must be two digits or a letter"),
        ({"application": "07", "gs1": True}, "application is '07', but must be left out with gs1"),
        ({"eci": 1_000_000}, "eci is 1000000, but must be 0 to 999999"),
        ({"text": "漢", "charset": "latin-1"}, "charset 'latin-1' does not write '漢'"),
        ({"charset": "klingon"}, "charset 'klingon' does not write"),
        ({"append": True}, "a message has 2 to 16 parts, got 1"),
        ({"text": "x" * 60, "eci": 26, "version": 1}, "does not fit version 1"),
    ],
)
def test_what_cannot_be_printed_is_refused(options, message):
    with pytest.raises(UsageError, match=message):
        simulate(**{"text": "1", **options})
