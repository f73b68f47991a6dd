# SPDX-License-Identifier: Apache-2.0
"""What a CODEC leaves: box plots (Figs. 7, 9, 10), arrays (npz) and a tidy table (csv)."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..codec import Codec
from ..codec.growth import Growth, growth_of
from ..errors import PlanError
from ..files import write_file
from ..typing import Array
from .style import pyplot, save


@dataclass(frozen=True)
class _Kind:
    """Which error is drawn.

    Attributes:
        name: of the axis. errors: of a CODEC, (n_cv, n_c), m. floor: what noise alone leaves of it, m. labelled: in the legend.
    """

    name: str
    errors: Callable[[Codec], Array]
    floor: Callable[[Codec], float]
    labelled: bool


_KINDS = (
    _Kind("Mean", lambda codec: codec.norm_mean, lambda codec: codec.floor_mean, True),
    _Kind("Maximum", lambda codec: codec.norm_max, lambda codec: codec.floor_max, False),
)
_FAR_APART = 8.0  # medians that differ by more than this factor are drawn on a logarithmic axis
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00")


def save_arrays(codec: Codec, path: str | Path) -> Path:
    """E_mu, E_m (n_cv, n_c, 3), norms (n_cv, n_c), m; C_a, C_v, rad/(N m); all parameters C, names; pose numbers."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, E_mu=codec.E_mean, E_m=codec.E_max, norm_mean=codec.norm_mean, norm_max=codec.norm_max,
        C_a=codec.C_a, C_v=codec.C_v, C=codec.C, names=np.array(codec.names), verification=codec.verification,
        training=codec.training, floor_mean=codec.floor_mean, floor_max=codec.floor_max,
    )  # fmt: skip
    return write_file(path, buffer.getvalue())


def save_table(codec: Codec, path: str | Path) -> Path:
    """One row for each combination and size of the training set: errors in m, parameters in their own units."""
    axes = [f"{kind}_{axis}_m" for kind in ("mean", "max") for axis in "xyz"]
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["combination", "training_poses", *axes, "mean_norm_m", "max_norm_m", *codec.names])
    n_cv, n_c = codec.norm_mean.shape
    for i in range(n_cv):
        for j in range(n_c):
            errors = [*codec.E_mean[i, j], *codec.E_max[i, j], codec.norm_mean[i, j], codec.norm_max[i, j]]
            writer.writerow([i + 1, j + 1, *(f"{value:.9g}" for value in (*errors, *codec.C[i, j]))])
    return write_file(path, text.getvalue())


def save_chart(codecs: Sequence[Codec], path: str | Path, title: str = "") -> Path:
    """Box plots of mean and maximum error on unseen poses against the number of training poses, one colour per CODEC.

    Boxes: quartiles over the combinations, whiskers to 1.5 box lengths. Dashed: what noise alone leaves. Vertical line with band:
    where growth has saturated, 5 to 95 %. Raises IrecError: matplotlib is not installed.
    """
    plt = pyplot()
    figure, axes = plt.subplots(2, 1, figsize=(11, 8), sharex=True, constrained_layout=True)
    for ax, kind in zip(axes, _KINDS, strict=True):
        _draw(ax, codecs, kind)
        _scale(ax, codecs, kind)
        ax.set_ylabel(f"{kind.name} error on\nverification poses [mm]")
        ax.grid(axis="y", which="both", color="0.92")
        ax.set_axisbelow(True)
    axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(codecs) + 1, frameon=False, fontsize=9)
    n_c = codecs[0].norm_mean.shape[1]
    axes[1].set_xticks(range(1, n_c + 1), labels=[str(j) for j in range(1, n_c + 1)])
    axes[1].set_xlim(0.3, n_c + 0.7)
    axes[1].set_xlabel("Number of training poses")
    n_cv, n_v = codecs[0].verification.shape
    figure.suptitle(f"{title + ': ' if title else ''}{codecs[0].poses} poses, {n_cv} combinations of {n_v} verification poses")
    return save(figure, path, 130)


def _draw(ax: Any, codecs: Sequence[Codec], kind: _Kind) -> None:
    """Boxes, medians, floor and saturation of every CODEC, in mm."""
    width = 0.8 / len(codecs)
    for k, codec in enumerate(codecs):
        colour, values = _COLOURS[k % len(_COLOURS)], 1e3 * kind.errors(codec)
        shift = (k - (len(codecs) - 1) / 2) * width
        at = np.arange(1, values.shape[1] + 1) + shift
        ax.boxplot(
            values, positions=at, widths=0.85 * width, manage_ticks=False, patch_artist=True,
            boxprops={"facecolor": colour, "alpha": 0.35, "edgecolor": colour}, medianprops={"color": colour, "linewidth": 1.6},
            whiskerprops={"color": colour}, capprops={"color": colour},
            flierprops={"marker": ".", "markersize": 3, "markeredgecolor": colour},
        )  # fmt: skip
        label = f"{codec.label}: median {np.median(values[:, -1]):.3f} mm at the end" if kind.labelled else None
        ax.plot(at, np.median(values, axis=0), color=colour, linewidth=0.8, label=label)
        _draw_saturation(ax, codec, colour, kind.labelled)
    floor = 1e3 * kind.floor(codecs[0])
    ax.axhline(floor, color="black", linestyle="--", linewidth=1, label=f"stated instrument noise alone, {floor:.3f} mm")


def _draw_saturation(ax: Any, codec: Codec, colour: str, named: bool) -> None:
    try:
        growth: Growth = growth_of(codec)
    except PlanError:
        return
    if growth.saturated:
        low, high = growth.saturated_interval
        label = f"{codec.label}: saturated at {growth.saturated_at} ({low} to {high}) poses" if named else None
        ax.axvline(growth.saturated_at, color=colour, linestyle=":", label=label)
        ax.axvspan(low - 0.5, high + 0.5, color=colour, alpha=0.06, linewidth=0)


def _scale(ax: Any, codecs: Sequence[Codec], kind: _Kind) -> None:
    """An axis that shows the growth: errors with one or two poses may run out of it; logarithmic where curves differ a lot."""
    first = min(2, codecs[0].norm_mean.shape[1] - 1)
    values = [1e3 * kind.errors(codec)[:, first:] for codec in codecs]
    medians = np.concatenate([np.median(v, axis=0) for v in values])
    top = max(float(np.percentile(v, 99.5)) for v in values)
    floor = 1e3 * kind.floor(codecs[0])
    if medians.max() > _FAR_APART * medians.min():
        ax.set_yscale("log")
        ax.set_ylim(0.7 * min(floor or np.inf, *(float(v.min()) for v in values)), 1.5 * top)
        ax.yaxis.set_major_formatter("{x:g}")
    else:
        ax.set_ylim(0.0, max(1.15 * top, 1.3 * floor))
