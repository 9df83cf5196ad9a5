"""Raw light fields: from the bytes of a plenoptic camera to views, in the order of the files.

Reading: ``container`` sections of a file · ``contents`` which of them is what · ``layouts`` ``metadata`` what it says
of the shot · ``priors`` camera and optics from that · ``unpack`` sensor values · ``archive`` ``calibration`` white
images and hot pixels · ``raw`` all of it as one `RawCapture`.
Decoding: ``lattice`` where the lenses are · ``develop`` ``colour`` light and colour · ``reading`` ``resample`` from
lenses to view pixels · ``decode`` the views.
Importing this package costs nothing.
"""
