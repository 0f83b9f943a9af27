"""The promise of `tol` on scenes drawn at random: one seed or thousands.

    python tests/promise.py 17                   the scene of seed 17 by every engine, method and instruction set
    python tests/promise.py --count 5000         seeds 0 to 4999 in worker processes, and a table
    python tests/promise.py --count 200 --share  as the tests do: a share of the ways for each seed

A worker that dies or takes longer than a scene may is replaced, and its seed is named.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import multiprocessing
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from multiprocessing.connection import Connection, wait

import numpy as np
import promise_scenes
import promise_trial
from promise_trial import Outcome

LONGEST = 60.0  # s that one way of a scene may take


def table(outcomes: list[Outcome]) -> str:
    """Scenes, kept, refused and broken, median and worst error by tol, by engine and method."""
    rows = defaultdict(list)
    for outcome in outcomes:
        rows[outcome.way].append(outcome)
    lines = [
        f"{'error / tol':28} {'kept':>6} {'told':>5} {'refused':>7} {'no tree':>7} {'known':>5} {'broken':>6} "
        f"{'median':>8} {'worst':>9}"
    ]
    for way in sorted(rows):
        count = {v: sum(o.verdict == v for o in rows[way]) for v in ("kept", "told", "refused", "none", "known", "broken")}
        ratios = [o.ratio for o in rows[way] if o.verdict in ("kept", "told", "broken")]
        middle, worst = (float(np.median(ratios)), float(np.max(ratios))) if ratios else (np.nan, np.nan)
        lines.append(
            f"{way:28} {count['kept']:6} {count['told']:5} {count['refused']:7} {count['none']:7} {count['known']:5} "
            f"{count['broken']:6} {middle:8.3f} {worst:9.3g}"
        )
    return "\n".join(lines)


def words(outcome: Outcome) -> str:
    """One line on an outcome."""
    return f"seed {outcome.seed}: {outcome.way}: {outcome.verdict}, error {outcome.ratio:.3g} tol {outcome.words}".rstrip()


def _work(pipe: Connection, everything: bool) -> None:
    """Take seeds; tell what is begun, each outcome, and None after a scene's last."""
    faulthandler.enable()
    with contextlib.suppress(EOFError, OSError):  # the parent is gone
        while True:
            scene = promise_scenes.draw(pipe.recv())
            for step in promise_trial.steps(scene, everything):
                pipe.send(step)
            pipe.send(None)


class Worker:
    """A process that judges scenes, and what it is at."""

    def __init__(self, everything: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, there = context.Pipe()
        self.process = context.Process(target=_work, args=(there, everything), daemon=True)
        self.process.start()
        there.close()
        self.seed, self.way, self.since = -1, "", 0.0

    def take(self, seed: int) -> None:
        self.pipe.send(seed)
        # its first imports and compiles as well
        self.seed, self.way, self.since = seed, "the scene", time.monotonic() + (0 if self.seed >= 0 else LONGEST)

    def lost(self, words: str) -> Outcome:
        self.process.kill()
        self.process.join()
        return Outcome(self.seed, self.way, "broken", np.inf, words)


def run(seeds: list[int], everything: bool, jobs: int, longest: float = LONGEST) -> Iterator[Outcome]:
    """Outcomes of the seeds by `jobs` workers; one that dies, or takes longer than `longest` s for an image, is replaced."""
    queue = list(reversed(seeds))
    workers = [Worker(everything) for _ in range(min(jobs, len(queue)))]
    for worker in workers:
        worker.take(queue.pop())
    while workers:
        wait([worker.pipe for worker in workers], timeout=1.0)
        for i, worker in reversed(list(enumerate(workers))):
            words, done = "", False
            try:
                while worker.pipe.poll():
                    step = worker.pipe.recv()
                    worker.since = time.monotonic()
                    if isinstance(step, Outcome):
                        yield step
                    elif step is None:
                        done = True
                    else:
                        worker.way = step
            except (EOFError, ConnectionResetError):
                words = "the process died"
            if time.monotonic() - worker.since > longest:
                words = f"no answer within {longest:g} s"
            if words:
                yield worker.lost(words)
                workers[i] = Worker(everything) if queue else worker
            if (words or done) and queue:
                workers[i].take(queue.pop())
            elif words or done:
                worker.process.kill()
                del workers[i]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seed", nargs="*", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=0)
    parser.add_argument("--share", action="store_true", help="a share of the ways, as the tests take")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--longest", type=float, default=LONGEST, help="s that one image may take")
    given = parser.parse_args()
    outcomes = []
    if given.seed:
        faulthandler.enable()
        for seed in given.seed:
            scene = promise_scenes.draw(seed)
            print(f"seed {seed}, {scene.family}: tol {scene.tol:.3g}; {scene.words}", flush=True)
            for outcome in promise_trial.trial(scene, not given.share):
                print(f"  {words(outcome)} (share {outcome.share:.2f}, {outcome.seconds:.2f} s)", flush=True)
                outcomes.append(outcome)
    else:
        seeds = list(range(given.first, given.first + given.count))
        for outcome in run(seeds, not given.share, given.jobs, given.longest):
            outcomes.append(outcome)
            if outcome.verdict == "broken":
                print(words(outcome), flush=True)
        print(table(outcomes))
    broken = sorted({o.seed for o in outcomes if o.verdict == "broken"})
    print(f"{len({o.seed for o in outcomes})} scenes, {len(outcomes)} images, {len(broken)} scenes broken: {broken}")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
