"""A plan over a stream of data sets: the same images, in order, reading beside summing, errors where they belong."""

import threading

import numpy as np
import pytest
from scenes import PLANE, moving

import pysas


@pytest.fixture(scope="module")
def plan():
    return pysas.plan(moving(), PLANE, 1e-3)


DATA = [moving(seed=seed).data for seed in range(4)]


@pytest.fixture(autouse=True)
def no_thread_left():
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) == before


@pytest.mark.parametrize("kind", [list, iter, lambda data: (batch for batch in data), np.stack])
def test_images_are_those_of_the_plan_in_order(plan, kind):
    images = list(plan.stream(kind(DATA)))
    assert len(images) == len(DATA) and all(isinstance(image, pysas.Image) for image in images)
    for image, data in zip(images, DATA, strict=True):
        assert np.array_equal(image.data, plan(data).data)


def test_nothing_to_read(plan):
    assert list(plan.stream([])) == []


def test_the_next_batch_is_read_while_one_is_summed(plan, monkeypatch):
    """The sum of batch 0 does not begin before the reading of batch 1 has: each waits for the other, or fails after 20 s."""
    asked, summing = threading.Event(), threading.Event()
    readers = set()

    def batches():
        readers.add(threading.current_thread())
        yield DATA[0]
        asked.set()
        assert summing.wait(20)
        yield DATA[1]
        readers.add(threading.current_thread())

    call = type(plan).__call__

    def imaged(self, data):
        summing.set()
        assert asked.wait(20)
        return call(self, data)

    monkeypatch.setattr(type(plan), "__call__", imaged)
    assert len(list(plan.stream(batches()))) == 2
    assert len(readers) == 1 and threading.current_thread() not in readers


def test_one_batch_ahead_and_none_before_the_first_is_asked_for(plan):
    taken = []

    def batches():
        for number, batch in enumerate(DATA):
            taken.append(number)
            yield batch

    stream = plan.stream(batches())
    assert not taken
    next(stream)
    stream.close()  # waits for the one being read
    assert taken == [0, 1]


def test_an_error_of_the_iterable_comes_after_the_images_before_it(plan):
    def batches():
        yield from DATA[:2]
        raise OSError("disk gone")

    stream = plan.stream(batches())
    assert np.array_equal(next(stream).data, plan(DATA[0]).data)
    assert np.array_equal(next(stream).data, plan(DATA[1]).data)
    with pytest.raises(OSError, match="disk gone") as caught:
        next(stream)
    assert caught.value.__notes__ == ["batch 2 of the stream"]
    assert list(stream) == []


def test_an_error_of_a_batch_takes_the_place_of_its_image(plan):
    bad = DATA[1].copy()
    bad[3, 2, 7] = np.nan
    for wrong, text in ((bad, "non-finite sample at ping 3, channel 2"), (DATA[1][:3], "data: expected the planned shape")):
        stream = plan.stream([DATA[0], wrong, DATA[2]])
        next(stream)
        with pytest.raises(ValueError, match=text) as caught:
            next(stream)
        assert caught.value.__notes__ == ["batch 1 of the stream"]
        assert list(stream) == []


def test_what_is_no_iterable_is_named_at_once(plan):
    with pytest.raises(TypeError, match="batches=int: expected an iterable of arrays"):
        plan.stream(3)


@pytest.mark.parametrize("end", ["close", "break", "exception"])
def test_leaving_early_leaves_no_thread(plan, end):
    stream = plan.stream(DATA)
    if end == "close":
        next(stream)
        stream.close()
    elif end == "break":
        for _ in stream:
            break
        del stream
    else:
        with pytest.raises(KeyError):
            for _ in stream:
                raise KeyError
        stream.close()
    # the fixture counts the threads; the plan is as it was
    assert np.array_equal(plan(DATA[0]).data, next(plan.stream(DATA[:1])).data)
