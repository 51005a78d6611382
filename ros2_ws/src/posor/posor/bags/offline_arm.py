"""An arm for offline use: its joints and endpoint from a bag, in memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from posor.bags.arm_estimator import ArmEstimator
from posor.bags.bag_topics import topics_of
from posor.bags.offline_pipeline import estimate_bag
from posor.bags.reprocess_task import Settings
from posor.chain import arm_file
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates, JointEstimates

if TYPE_CHECKING:
    from posor.node_parameters import CovarianceKind


@dataclass(frozen=True)
class Arm(arm_file.Arm):
    """An arm file with its paths resolved, which estimates recorded scans."""

    def estimate(
        self, bag: Path | str, *, covariance: CovarianceKind | None = None, false_alarm: float | None = None
    ) -> ArmEstimates:
        """Return the poses and covariances of all joints and of the endpoint, as the nodes would have published them.

        Args:
            bag: Folder with metadata.yaml, or a single .mcap or .db3 file, with scans on topics ``.../<joint>/raw``.
            covariance: Part of the uncertainty in the covariances: of the readings' noise (random), of the calibration
                (systematic), or of both (total); None: as the arm file says of each joint, total without a word.
            false_alarm: Probability that the chi-square test rejects a sound scan; None: as the arm file says.

        Raises:
            ParameterError: There is no such part of the uncertainty, or ``false_alarm`` is not a probability.
            PosorError: The bag, a calibration or the kinematic chain cannot be used.

        """
        settings = Settings.of_arm(self).with_estimation(covariance=covariance, false_alarm=false_alarm)
        estimator = ArmEstimator(settings)
        parts = list(estimate_bag(Path(bag), topics_of(Path(bag), settings.joints), estimator))
        joints = {name: JointEstimates.concatenate([part.joints[name] for part in parts]) for name in settings.joints}
        return ArmEstimates(joints, EndpointEstimates.concatenate([part.endpoint for part in parts]), parts[0].chain)


def load_arm(path: Path | str) -> Arm:
    """Read an arm file; the files that it names are read by ``Arm.estimate``.

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or has invalid content.

    """
    return Arm(**vars(arm_file.load_arm(Path(path))))
