# SPDX-License-Identifier: Apache-2.0
"""`irec codec SESSION -o DIR`: accuracy competency development chart, Algorithm 1, and the three comparisons of the paper."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..codec import TRAIN_TO_TEST, Codec, pose_data, run_codec
from ..codec.algorithm1 import ESTIMATOR
from ..codec.follow import follow
from ..codec.growth import growth_of
from ..errors import IrecError, PlanError
from ..files import all_or_none
from ..identification.absolute import base_terms
from ..model import EIGHTEEN_DOF, SIX_DOF, Term, blank_model
from ..model.file import check_belongs, load_model
from ..poses.select import METHODS
from ..report.codec_charts import save_arrays, save_chart, save_table
from ..report.style import pyplot
from ..session import Session, read_session

COMPARISONS = {
    "pose-search": "training poses chosen by ioops against cover (Fig. 7)",
    "model": "6 against 18 degrees of freedom, or two models by --model (Fig. 9)",
    "load-cases": "training on the normal load case only against all (Fig. 10)",
}


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("-o", "--output", default="codec", help="folder for chart, arrays and table (default: codec)")
    about = "; ".join(f"{name}: {text}" for name, text in COMPARISONS.items())
    parser.add_argument("--compare", choices=list(COMPARISONS), help=about)
    parser.add_argument("--method", choices=list(METHODS), default="cover", help="how the training set grows (default: cover)")
    parser.add_argument(
        "--model",
        action="append",
        metavar="MODEL",
        help="6, 18, geometric, effect ids with commas between, or a model file; twice with --compare model (default: 18, for "
        "absolute sessions geometric)",
    )
    parser.add_argument("--normal-case", type=int, default=1, help="the normal load case, for --compare load-cases (default: 1)")
    parser.add_argument("--combinations", type=int, help="N_cv (default: as many as poses, which is the most)")
    parser.add_argument(
        "--ratio", type=float, default=TRAIN_TO_TEST, help="training poses per verification pose (default: 70/30)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the random draws (default: 1)")
    parser.add_argument(
        "--follow", action="store_true", help="the recording is still being written: chart and verdict after every pose"
    )
    parser.add_argument("--json", action="store_true", help="machine-readable figures on standard output")


def run(args: argparse.Namespace) -> int:
    if args.follow:
        return _follow(args)
    session = read_session(args.session)
    codecs = _codecs(session, args)
    folder = Path(args.output)
    files = []
    missing = ""
    try:
        pyplot()
    except IrecError as error:
        missing = str(error)
    with all_or_none():
        for codec in codecs:
            stem = "codec" if len(codecs) == 1 else "codec_" + "".join(c if c.isalnum() else "_" for c in codec.label)
            files += [save_arrays(codec, folder / f"{stem}.npz"), save_table(codec, folder / f"{stem}.csv")]
        if not missing:
            files.append(save_chart(codecs, folder / "codec.png", session.name))
    figures = [_figures(codec) for codec in codecs]
    if args.json:
        print(json.dumps({"session": session.name, "files": [str(f) for f in files], "codecs": figures}))
        return 0
    n_cv, n_v = codecs[0].verification.shape
    print(f"{session.name}: {codecs[0].poses} poses, {n_cv} combinations of {n_v} verification poses")
    for figure in figures:
        print(
            f"{figure['label']}: error on unseen poses with {figure['training_poses']} training poses: "
            f"mean {1e6 * figure['mean_m']:.1f} um, maximum {1e6 * figure['max_m']:.1f} um "
            f"(instrument noise alone {1e6 * figure['floor_mean_m']:.1f} and {1e6 * figure['floor_max_m']:.1f} um)"
        )
        print(f"  {figure['growth']}")
    if missing:
        print(f"no chart: {missing}")
    print(f"wrote {', '.join(str(f) for f in files)}")
    return 0


def _follow(args: argparse.Namespace) -> int:
    models = args.model or ["18"]
    if args.compare or len(models) > 1 or Path(models[0]).exists():
        raise PlanError("--follow takes one model by its effects (--model 6, 18 or ids), and no comparison")
    folder = Path(args.output)
    for news in follow(args.session, _blank(models[0])):
        if news.codec is not None:
            save_chart([news.codec], folder / "codec.png", Path(args.session).name)
        if args.json:
            print(json.dumps({"poses": news.poses, **(_figures(news.codec) if news.codec else {"growth": news.why})}), flush=True)
        else:
            print(f"{news.poses} poses: {news.growth or news.why}", flush=True)
    return 0


def _codecs(session: Session, args: argparse.Namespace) -> list[Codec]:
    options = {"combinations": args.combinations, "ratio": args.ratio, "seed": args.seed}
    models = args.model or []
    if len(models) > (2 if args.compare == "model" else 1):
        raise PlanError(f"{len(models)} models were given; two are compared with --compare model, otherwise one is used")
    if args.compare == "model":
        if len(models) == 1:
            raise PlanError("--compare model takes --model twice, or not at all for 6 against 18 degrees of freedom")
        if not models and session.kind == "absolute":
            raise PlanError("--compare model on an absolute session needs --model twice: 6 against 18 DOF is for loaded ones")
        first, second = models or ["6", "18"]
        return [
            run_codec(pose_data(session, _terms(m, session)), method=args.method, label=_label(m), **options)
            for m in (second, first)
        ]
    model = models[0] if models else ("18" if session.kind == "loaded" else "geometric")
    terms = _terms(model, session)
    if args.compare == "pose-search":
        data = pose_data(session, terms)
        return [run_codec(data, method=method, label=method, **options) for method in ("cover", "ioops")]
    if args.compare == "load-cases":
        if session.kind == "absolute":
            raise PlanError("--compare load-cases needs a loaded session, this one is absolute")
        normal = session.case_name(args.normal_case)
        every = run_codec(pose_data(session, terms), method=args.method, label="all load cases", **options)
        only = pose_data(session, terms, [args.normal_case])
        return [every, run_codec(only, method=args.method, label=f"{normal} only", **options)]
    return [run_codec(pose_data(session, terms), method=args.method, label=f"{_label(model)}, {args.method}", **options)]


def _terms(model: str, session: Session) -> Sequence[Term]:
    if model not in ("6", "18") and (Path(model).suffix in (".yaml", ".yml") or Path(model).exists()):
        loaded = load_model(model)
        check_belongs(loaded, session.robot, session.serial)
        return loaded.terms
    return _blank(model)


def _blank(model: str) -> Sequence[Term]:
    if model == "geometric":
        return base_terms()
    if model in ("6", "18"):
        return blank_model(SIX_DOF if model == "6" else EIGHTEEN_DOF)
    return blank_model([effect.strip() for effect in model.split(",")])


def _label(model: str) -> str:
    return f"{model} DOF" if model in ("6", "18") else Path(model).stem if Path(model).suffix else model


def _figures(codec: Codec) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "estimator": ESTIMATOR,
        "label": codec.label,
        "training_poses": codec.norm_mean.shape[1],
        "mean_m": float(codec.norm_mean[:, -1].mean()),
        "max_m": float(codec.norm_max[:, -1].mean()),
        "mean_curve_m": [float(v) for v in np.mean(codec.norm_mean, axis=0)],
        "floor_mean_m": codec.floor_mean,
        "floor_max_m": codec.floor_max,
    }
    try:
        growth = growth_of(codec)
    except PlanError as error:
        return {**figures, "growth": str(error)}
    return {
        **figures,
        "saturated_at": growth.saturated_at if growth.saturated else None,
        "saturated_interval": list(growth.saturated_interval),
        "next_gain": growth.next_gain,
        "next_gain_interval": list(growth.next_gain_interval),
        "enough": growth.enough,
        "growth": str(growth),
    }
