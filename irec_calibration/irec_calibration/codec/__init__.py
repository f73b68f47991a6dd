# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 (CODEC): how the error over poses not used for identification falls with the number of poses that are."""

from .algorithm1 import RIDGE, TRAIN_TO_TEST, Codec, PoseData, pose_data, run_codec, split_sizes

__all__ = ["RIDGE", "TRAIN_TO_TEST", "Codec", "PoseData", "pose_data", "run_codec", "split_sizes"]
