"""Placement, interleaving, masks and format words of all versions, against symbols that segno made."""

import numpy as np
import pytest
import reedsolo
import segno
from segno import consts

from evqr.symbol.qr_codewords import codeword_layout, format_words, mask_signs, roles_of, symbol_of
from evqr.symbol.qr_tables import LEVELS


def make(version, level, mask, text="evqr"):
    symbol = segno.make(text, version=version, error=level, mask=mask, boost_error=False, micro=False)
    return np.where(np.array(symbol.matrix, dtype=bool), -1, 1)


@pytest.mark.parametrize("version", range(1, 41))
def test_codewords_of_every_version(version):
    for number, level in list(enumerate(LEVELS))[version % 2 :: 2]:  # the others of its neighbours
        mask = (version + number) % 8
        grid = make(version, level, mask)
        layout = codeword_layout(version, level)
        codewords = np.packbits((grid.ravel() * mask_signs(version)[mask])[layout.bits] < 0)

        table = consts.ECC[version][consts.ERROR_MAPPING[level]]
        assert len(layout.blocks) == sum(ec.num_blocks for ec in table)
        assert len(codewords) == sum(ec.num_blocks * ec.num_total for ec in table)
        for block in layout.blocks:
            part = bytearray(codewords[block.codewords].tobytes())
            assert len(part) == block.n_data + block.n_check
            assert reedsolo.RSCodec(block.n_check, nsize=len(part)).check(part) == [True]
        np.testing.assert_array_equal(symbol_of(codewords, version, level, mask), grid)


@pytest.mark.parametrize("version", [1, 7, 24])
def test_data_is_in_order_over_the_blocks(version):
    text = "0123456789abcdefghijklmnopqrstuvwxyz"[: 14 if version == 1 else 36]
    layout = codeword_layout(version, "M" if version > 1 else "L")
    grid = make(version, "M" if version > 1 else "L", 2, text)
    codewords = np.packbits((grid.ravel() * mask_signs(version)[2])[layout.bits] < 0)
    data = np.concatenate([codewords[b.codewords][: b.n_data] for b in layout.blocks])
    bits = np.unpackbits(data)[4 + (8 if version < 10 else 16) :]
    assert np.packbits(bits).tobytes().startswith(text.encode())


@pytest.mark.parametrize("version", [1, 2, 9])
def test_format_words_are_those_in_the_symbols(version):
    words = format_words(version)
    assert words.signs.shape == (32, 30)
    assert len(set(words.meaning)) == 32
    for word, (level, mask) in list(zip(words.signs, words.meaning, strict=True))[::5]:
        grid = make(version, level, mask)
        np.testing.assert_array_equal(word, grid[roles_of(version).format])
        np.testing.assert_array_equal(word, grid.ravel()[words.at])
    apart = (words.signs[:, None] != words.signs).sum(-1)[~np.eye(32, dtype=bool)]
    assert apart.min() >= 10  # two copies of a word that differs in five bits or more


def test_masks_leave_all_but_data_alone():
    signs = mask_signs(3).reshape(8, 29, 29)
    data = roles_of(3).data
    assert (signs[:, ~data] == 1).all()
    assert all(0.3 < (sign[data] < 0).mean() < 0.7 for sign in signs)
    np.testing.assert_array_equal(signs[0][data] < 0, (np.indices((29, 29)).sum(0) % 2 == 0)[data])


@pytest.mark.parametrize(("version", "level"), [(1, "L"), (5, "Q"), (9, "H"), ("M3", "M")])
def test_syndromes_of_all_blocks_are_those_of_each(version, level):
    layout = codeword_layout(version, level)
    codewords = np.random.default_rng(0).integers(0, 256, len(layout.bits) // 8, np.uint8)
    alone = [block.code.syndromes(codewords[block.codewords]) for block in layout.blocks]
    together = layout.syndromes(codewords)
    assert len(together) == len(alone)
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one, other)
