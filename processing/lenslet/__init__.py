"""Raw light fields: from the bytes of a plenoptic camera to views.

``container`` sections of a file · ``metadata`` what it says of the shot · ``unpack`` sensor values · ``calibration``
white images and hot pixels · ``raw`` all of it as one `RawCapture`. Importing this package costs nothing.
"""
