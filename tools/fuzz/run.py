# SPDX-License-Identifier: Apache-2.0
"""Fuzz every reader of files: `python tools/fuzz/run.py --seconds 60`. Exit 1 if a reader fails in any but the one right way.

A mutated file is read, or refused by an error of ours in one line. A trace, more than 10 s, more than 1 GB, a crash of the
process, or an error of several lines is a finding; the file is kept in out/fuzz with the number that makes it again.
"""

from __future__ import annotations

import argparse
import atexit
import collections
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

SECONDS = 10
START = 240  # s that a worker may take to import everything on a busy machine
MEMORY = 1_000_000_000  # bytes beyond what the process has before the first file
HERE = Path(__file__).resolve().parent


class _Hang(BaseException):
    pass


def work(folder: Path, seed: int, begin: int, seconds: float, last: int, only: str) -> None:
    """Worker: read mutated files in turn until the time is over or up to number `last`, print a line of JSON for each."""
    sys.path.insert(0, str(HERE))
    warnings.simplefilter("ignore")
    from irec_calibration.errors import IrecError
    from irec_sim.errors import SimError
    from targets import targets

    def hang(*_: object) -> None:
        raise _Hang

    signal.signal(signal.SIGALRM, hang)
    everything = [t for t in targets() if only in t.name]
    originals = {t.file: (folder / t.file).read_bytes() for t in everything}
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    end = time.monotonic() + seconds
    number = begin
    while time.monotonic() < end and number < last:
        target = everything[number % len(everything)]
        rng = random.Random(f"{seed} {number}")
        path = folder / target.file
        data = target.mutate(originals[target.file], rng)
        path.write_bytes(data)
        print(json.dumps({"begin": number, "target": target.name, "file": target.file}), flush=True)
        began, result = time.monotonic(), "read"
        signal.alarm(SECONDS)
        try:
            target.read(folder)
        except (IrecError, SimError) as error:
            result = "refused"
            if "\n" in str(error) or not str(error):
                result = f"an error of several lines: {str(error)[:300]!r}"
            elif str(folder) not in str(error) and target.names_file:
                result = f"an error that names no file: {str(error)[:300]!r}"
        except _Hang:
            result = f"more than {SECONDS} s"
        except MemoryError:
            result = "more than 1 GB"
        except Exception as error:
            frames = traceback.extract_tb(error.__traceback__)
            ours = [f for f in frames if "irec_" in f.filename] or frames
            result = (
                f"{type(error).__name__}: {str(error)[:200]} ({Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name})"
            )
        finally:
            signal.alarm(0)
        path.write_bytes(originals[target.file])
        print(json.dumps({"number": number, "result": result, "s": round(time.monotonic() - began, 3)}), flush=True)
        number += 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--files", type=int, help="end after so many files, however long they take")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the name of the readers to try")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="folder for files that made a reader fail")
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    seconds, last = (args.seconds, sys.maxsize) if args.files is None else (math.inf, args.files)
    if args.worker:
        work(Path(args.worker[0]), args.seed, int(args.worker[1]), seconds, last, args.only)
        return 0
    folder = Path(tempfile.mkdtemp(prefix="irec-fuzz-"))
    sys.path.insert(0, str(HERE))
    from targets import make_corpus

    make_corpus(folder)
    runs: collections.Counter[str] = collections.Counter()
    refused: collections.Counter[str] = collections.Counter()
    longest: dict[str, float] = collections.defaultdict(float)
    findings: list[tuple[str, str, int]] = []
    number, end = 0, time.monotonic() + seconds
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # whoever ends it wants the counts too
    try:
        while time.monotonic() < end and number < last:
            number = _one_worker(args, folder, number, end, runs, refused, longest, findings)
    except KeyboardInterrupt:
        print("stopped; so far:")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        folder.with_suffix(".err").unlink(missing_ok=True)
    print(f"{'reader':<20}{'files':>8}{'read':>8}{'refused':>9}{'failed':>8}{'longest, s':>12}")
    for name in runs:
        failed = sum(f[0] == name for f in findings)
        read = runs[name] - refused[name] - failed
        print(f"{name:<20}{runs[name]:>8}{read:>8}{refused[name]:>9}{failed:>8}{longest[name]:>12.2f}")
    for (name, result), numbers in _grouped(findings).items():
        print(f"FAILED {name}: {result} ({len(numbers)} times, e.g. number {numbers[0]} of seed {args.seed})")
    print(f"{sum(runs.values())} files, {len(findings)} failures")
    return 1 if findings else 0


def _grouped(findings: list[tuple[str, str, int]]) -> dict[tuple[str, str], list[int]]:
    out: dict[tuple[str, str], list[int]] = collections.defaultdict(list)
    for name, result, number in findings:
        out[name, result].append(number)
    return out


def _one_worker(args, folder, number, end, runs, refused, longest, findings) -> int:  # type: ignore[no-untyped-def]
    """Run one worker until the time is over or it dies; returns the number to go on with."""
    left = max(end - time.monotonic(), 1.0)
    command = [sys.executable, __file__, "--worker", str(folder), str(number), "--seed", str(args.seed), "--seconds", str(left)]
    errors = open(folder.with_suffix(".err"), "w")
    command += ["--only", args.only, *([] if args.files is None else ["--files", str(args.files)])]
    worker = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
    atexit.register(worker.kill)
    watch = _Watch(worker)
    current: dict[str, object] = {}
    for line in worker.stdout or ():
        watch.alive()
        try:
            said = json.loads(line)
        except ValueError:
            continue  # a library that prints
        if "begin" in said:
            current = said
            continue
        name = str(current["target"])
        runs[name] += 1
        number = said["number"] + 1
        longest[name] = max(longest[name], said["s"])
        if said["result"] == "refused":
            refused[name] += 1
        elif said["result"] != "read":
            findings.append((name, said["result"], said["number"]))
        current = {}
    watch.stop()
    code = worker.wait()
    if code != 0 and not current:
        said_last = Path(folder.with_suffix(".err")).read_text()[-2000:]
        raise SystemExit(f"the worker ended with {code} between two files:\n{said_last}")
    if code != 0:
        name = str(current["target"])
        runs[name] += 1
        findings.append((name, f"the process ended with {code}", int(str(current["begin"]))))
        args.keep.mkdir(parents=True, exist_ok=True)
        kept = args.keep / f"{args.seed}-{current['begin']}-{Path(str(current['file'])).name}"
        if (folder / str(current["file"])).is_file():
            shutil.copyfile(folder / str(current["file"]), kept)
        number = int(str(current["begin"])) + 1
        shutil.rmtree(folder)
        folder.mkdir()
        from targets import make_corpus

        make_corpus(folder)
    return number


class _Watch:
    """Kills a worker that says nothing for three times the limit: it hangs below Python."""

    def __init__(self, worker: subprocess.Popen[str]) -> None:
        import threading

        self._worker, self._last, self._done = worker, time.monotonic() + START, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.wait(1.0):
            if time.monotonic() - self._last > 3 * SECONDS + 30:
                self._worker.kill()
                return

    def alive(self) -> None:
        self._last = time.monotonic()

    def stop(self) -> None:
        self._done.set()


if __name__ == "__main__":
    sys.exit(main())
