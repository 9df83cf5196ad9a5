"""From light fields and a photo to a synthesized light field: one file per stage, read top to bottom.

``model`` nouns · ``geometry`` projections · ``dpv`` light field → disparity evidence · ``poses/`` captures → poses and
anchors · ``scale_fit`` disparity ↔ inverse depth · ``fusion`` evidence of all sources in the target's frustum ·
``regularise`` evidence → surface · ``refine`` smoothing, unseen areas (later: the wide-baseline refinement) ·
``edges`` near or far, by the photo's colours · ``confidence`` how far to trust it ·
``synthesis`` surface → disparity field → views · ``pipeline`` the stages in order · ``metrics`` how good ·
``kernels/`` the C++ core and its NumPy twins · ``report/`` pictures and the HTML page · ``export/`` files for others.

Stages are pure functions: arrays in, arrays out, no files, no globals. Importing this package costs nothing.
"""
