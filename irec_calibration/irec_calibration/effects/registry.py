# SPDX-License-Identifier: Apache-2.0
"""Where effects are found by their ids: the catalogue, installed packages, files of the user.

A broken package or file hinders nobody who does not ask for its effect, and none can take the place of an effect of the
catalogue.
"""

from __future__ import annotations

import os
import sys
from functools import cache, lru_cache
from importlib.metadata import EntryPoint, entry_points

from ..errors import EffectError
from .base import Effect
from .catalogue import CATALOGUE

GROUP = "irec.effects"  # of entry points; the name of each is the id of its effect
FILES = "IREC_EFFECTS"  # environment variable: files with effects, separated as PATH is
HOW_TO_ADD = (
    f"an effect in a file of your own: --effects FILE of the irec commands, {FILES}=FILE in the environment of a node, or an"
    " installed package (docs/adding-an-effect.md)"
)

_catalogue: dict[str, Effect] = {cls.id: cls() for cls in CATALOGUE}
_registered: dict[str, Effect] = {}
_files: dict[str, str] = {}  # id of a registered effect -> the file that defines it


def register(effect: Effect, file: str = "") -> None:
    """Make an effect of the user known in this process. A file that is read again replaces what it defined before.

    Raises:
        EffectError: its id is one of the catalogue, or of another effect that is registered.
    """
    taken = _catalogue.get(effect.id) or _registered.get(effect.id)
    read_again = effect.id in _registered and bool(file) and _files.get(effect.id) == file
    if taken is not None and type(taken) is not type(effect) and not read_again:
        owner = _files.get(effect.id, type(taken).__module__)
        raise EffectError(f"effect id '{effect.id}' is taken already by {owner}; give yours another id")
    _registered[effect.id] = effect
    if file:
        _files[effect.id] = file


def find_effect(effect_id: str) -> Effect:
    """The effect of an id, or of the dotted path of an installed or registered effect class.

    Raises:
        EffectError: no such effect (names those that exist), or the package or file that offers it can't be loaded.
    """
    found = _catalogue.get(effect_id) or _registered.get(effect_id)
    if found is not None:
        return found
    points = [p for p in _points() if effect_id in (p.name, p.value.replace(":", "."))]
    if points:
        return _loaded(points[0].name)
    by_path = {f"{type(e).__module__}.{type(e).__qualname__}": e for e in {**_catalogue, **_registered}.values()}
    if effect_id in by_path:
        return by_path[effect_id]
    failed = _read_files(os.environ.get(FILES, ""))
    if effect_id in _registered:
        return _registered[effect_id]
    why = "".join(f"; {error}" for error in failed)
    raise EffectError(f"effect '{effect_id}' is not known; there are {', '.join(known_effects())}; {HOW_TO_ADD}{why}")


def known_effects() -> dict[str, Effect]:
    """All effects by id that can be loaded: the catalogue, installed packages, files of the user, those registered."""
    _read_files(os.environ.get(FILES, ""))
    installed = {name: _try_loaded(name) for name in dict.fromkeys(p.name for p in _points())}
    sound = {name: e for name, e in installed.items() if isinstance(e, Effect) and name not in _catalogue}
    return {**_catalogue, **sound, **_registered}


def broken_effects() -> dict[str, str]:
    """Effects that are offered but can't be used: entry point or file -> why."""
    failed = {f"{FILES}[{i}]": error for i, error in enumerate(_read_files(os.environ.get(FILES, "")))}
    installed = {p.name: _try_loaded(p.name) for p in _points()}
    return {**{name: e for name, e in installed.items() if isinstance(e, str)}, **failed}


def _points() -> tuple[EntryPoint, ...]:
    """Those of the packages that are installed now: to look through all of them takes 20 ms, and effects are asked for often."""
    return _points_of(tuple((folder, _changed(folder)) for folder in sys.path))


@lru_cache(maxsize=1)
def _points_of(folders: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    """folders: of packages, each with when something was put into it or taken out."""
    return tuple(entry_points(group=GROUP))


def _changed(folder: str) -> int:
    try:
        return os.stat(folder or os.curdir).st_mtime_ns
    except OSError:
        return 0


def _loaded(name: str) -> Effect:
    found = _try_loaded(name)
    if isinstance(found, str):
        raise EffectError(found)
    return found


def _try_loaded(name: str) -> Effect | str:
    """The effect of an installed package, or why it can't be used."""
    points = [p for p in _points() if p.name == name]
    values = sorted({p.value for p in points})
    if name in _catalogue:
        return f"effect '{name}' of {', '.join(values)}: the catalogue has an effect of this id; the package must choose another"
    if len(values) > 1:
        return f"effect '{name}' is offered by {' and '.join(values)}; uninstall one of the packages"
    return _load(points[0])


@cache
def _load(point: EntryPoint) -> Effect | str:
    where = f"effect '{point.name}' of {point.value}"
    try:
        effect = point.load()()
    except Exception as error:  # whatever a foreign package raises must name that package and hinder nobody else
        return f"{where}: can't be loaded: {type(error).__name__}: {error}"
    if not isinstance(effect, Effect):
        return f"{where}: gives a {type(effect).__name__}, an Effect is needed"
    if effect.id != point.name:
        return f"{where}: its id is '{effect.id}'; the entry point must have the same name"
    return effect


@cache
def _read_files(paths: str) -> tuple[str, ...]:
    """Register the effects of files, once; what went wrong."""
    from .user import register_file  # which registers here

    failed = []
    for path in filter(None, paths.split(os.pathsep)):
        try:
            register_file(path)
        except EffectError as error:
            failed.append(f"{FILES}: {error}")
    return tuple(failed)
