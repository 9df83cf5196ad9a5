"""Descriptions of results and of the JSON documents around them."""

from __future__ import annotations

from pathlib import Path

from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.result import ReportDocument
from lfrig.contracts.score import ScoreDocument
from lfrig.contracts.truth import TruthDocument
from lfrig.rig.info.text import Description, count

RESULT_FILES = ("disparity.pfm", "disparity_sigma.npy", "confidence.npy", "inverse_depth.npy", "report.html")


def describe_result(path: Path) -> Description:
    """A result folder; its missing files are problems."""
    report = ReportDocument.load(path / "report.json")
    target = report.target
    views = [f"views/{row:02d}_{col:02d}.png" for row in range(target.rows) for col in range(target.cols)]
    missing = [name for name in (*RESULT_FILES, *views) if not (path / name).is_file()]
    score = ScoreDocument.load(path / "score.json") if (path / "score.json").is_file() else None
    return {
        **describe_report(report),
        "type": "result",
        "score": _score_facts(score) if score else None,
        "unknown": [] if score else ["score"],
        "problems": [f"{name} is missing" for name in missing],
    }


def describe_report(report: ReportDocument) -> Description:
    """What report.json says."""
    target = report.target
    return {
        "type": "report",
        "summary": f"result, preset {report.preset}, {target.rows}×{target.cols} views of "
        f"{target.width}×{target.height} px from {count(len(report.sources), 'source')}",
        "target": target.model_dump(mode="json", exclude_none=True, exclude={"pose"}),
        "poses": report.poses,
        "sources": [{"id": s.id, "anchors": s.anchors, "inliers": s.inliers} for s in report.sources],
        "cpu_s": sum(stage.cpu_s for stage in report.stages),
        "warnings": [warning.message for warning in report.warnings],
        "version": report.version,
    }


def describe_score(path: Path) -> Description:
    """A score.json."""
    return {"type": "score", "summary": "score of a result", **_score_facts(ScoreDocument.load(path))}


def _score_facts(score: ScoreDocument) -> Description:
    facts: Description = {"bf_px_m": score.bf_px_m}
    if "all" in score.disparity:
        whole = score.disparity["all"]
        facts |= {"mse_px2": whole.mse, "ppe_005": whole.ppe_005, "ppe_010": whole.ppe_010}
    if score.views is not None:
        facts |= {"psnr_db": score.views.psnr, "ssim": score.views.ssim}
    return facts


def describe_truth(path: Path) -> Description:
    """The truth.json of a simulated session."""
    truth = TruthDocument.load(path)
    return {
        "type": "truth",
        "summary": f"truth of the simulated scene {truth.scene!r}, seed {truth.seed}",
        "captures": [{"id": name, "kind": capture.kind} for name, capture in truth.captures.items()],
    }


def describe_bench(path: Path) -> Description:
    """A benchmark's numbers; failed checks are problems."""
    bench = BenchDocument.load(path)
    return {
        "type": "bench",
        "summary": f"benchmark {bench.name!r}, {count(len(bench.rows), 'row')}, {count(len(bench.checks), 'check')}",
        "machine": bench.machine,
        "commit": bench.commit,
        "problems": [
            f"check {check.name!r} failed: {check.value:g} {check.direction} {check.bound:g} does not hold"
            for check in bench.checks
            if not check.ok
        ],
    }
