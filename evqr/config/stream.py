"""Settings of the loop over time: when to search, how to follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from evqr.config.settings import Count, NotNegative, Positive, Range, Settings, Share


@dataclass(frozen=True, kw_only=True)
class SchedulerConfig(Settings):
    """When a stream is searched for codes.

    Attributes
    ----------
    unknown_us : int [us]
        Time between two searches while the speed is unknown. Chosen.
    longest_us : int [us]
        Longest time between two searches. Chosen: what is in view now may be slow, and a fast code may come.
    seldom : float
        How much less often is searched while a code that was read is followed. Chosen.
    searches_across : int
        How often is searched at least while something crosses the image: half as often after each search in
        which something moved and no code was read, up to that. Chosen: the first few miss nothing that
        enters, and a code that fills a third of the way is wholly in view in five.
    every_kind : int
        Of so many searches in a row in which something moves and no code is read, one is for all kinds of
        symbols that are asked for, the others for QR and Micro QR codes; every second of these is for QR
        codes that are tilted, bent, small, turning or lack a pattern, too. Chosen: a search for all takes
        several times as long where there is no code.
    given_up_across : float
        How far something that was given up goes until it is searched again, as a share of the way across the
        image. Chosen: what cannot be read is followed twice as it passes.
    codes_a_search : int
        Codes that one search finds at most. Chosen.
    margin_modules : float [modules]
        Around a followed code whose events a search does not see: its quiet zone. The standard's four
        modules.
    same_place : float
        How far at most from where a lost code must be one with the same text may be found for them to be one,
        in sizes of the code. Chosen: two codes cannot overlap.
    same_velocity : float
        How much the velocity of a code that is found again may differ in any case, relative to the faster of
        the two; the place may differ by half of that share of its way. Chosen: from cold it was seen to be
        off by 0.4 for a code that turns.
    acceleration : float [sizes/s^2]
        How fast its velocity may change beside that. Chosen: half of gravity for a code of 10 cm.
    turn_rate : float [deg/s]
        How fast it may have turned, beside how it was seen to turn. Chosen: half a turn a second, in a hand.
    growth_rate : float [1/s]
        How fast it may have grown or shrunk. Chosen: it comes as near again within a quarter of a second.
    remembered_codes : int
        Codes at most that may be found again; the oldest are forgotten first. Chosen: more than are in view.
    """

    unknown_us: Count = 2_000
    longest_us: Count = 20_000
    seldom: Annotated[float, Range(least=1.0)] = 2.0
    searches_across: Count = 8
    every_kind: Count = 2
    given_up_across: NotNegative = 0.5
    codes_a_search: Count = 16
    margin_modules: NotNegative = 4.0
    same_place: Positive = 0.5
    same_velocity: Share = 0.5
    acceleration: Positive = 50.0
    turn_rate: NotNegative = 180.0
    growth_rate: NotNegative = 3.0
    remembered_codes: Count = 64


@dataclass(frozen=True, kw_only=True)
class TrackConfig(Settings):
    """How one code is followed from window to window.

    Attributes
    ----------
    baseline : int [windows]
        Over which the velocity is measured. Chosen: long enough for precision, short enough for a speed that
        changes.
    full_effort_every : int [windows]
        Between two attempts at decoding their sum with many erasures; the others are quick. Chosen.
    found_again : tuple of int [windows]
        Windows without a reading after which a code is searched for again where it is. Chosen: it may have
        been taken for one of another size, or turned by a right angle.
    good_found_again : tuple of int [windows]
        The same for a code that agrees well with its known modules. Chosen: each is another chance that its
        pose is right.
    patience : int [windows]
        Without a reading, after which a code that agrees badly with its known modules is given up. Chosen.
    single_patience : int [windows]
        The same for a symbol with a single finder pattern, or found by edges. Chosen: it may be another size
        of the symbol, which a search that knows the motion better tells, the corner of another code, or an
        edge of anything.
    good_patience : int [windows]
        The same for any code, however well it agrees. Chosen: slow pixels were seen to take 17 windows, and
        a print that looks like a code takes no more.
    max_misses : int [windows]
        In a row without the code, after which it is lost. Chosen.
    """

    baseline: Annotated[int, Range(least=2)] = 8
    full_effort_every: Count = 4
    found_again: tuple[Count, ...] = (2, 6)
    good_found_again: tuple[Count, ...] = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32)
    patience: Count = 16
    single_patience: Count = 4
    good_patience: Count = 32
    max_misses: Count = 2
