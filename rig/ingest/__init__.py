"""Foreign light fields and photos into a session: one file per format, each with its detector.

``formats`` the detectors in order · ``candidate`` what a detector returns · ``capture_json`` ``hci`` ``raw`` ``eslf``
``sai`` ``photo`` the formats · ``calibration`` what decodes raw files · ``run`` ingest into a session, or open without
one.
"""

from lfrig.rig.ingest.run import IngestedCapture, ingest, open_light_field

__all__ = ["IngestedCapture", "ingest", "open_light_field"]
