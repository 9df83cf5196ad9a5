"""Files for other programs, and the result folder itself.

``result`` the files of a result (write and load) · ``pfm`` ``png`` codecs · ``content`` what can be exported ·
``registry`` format names → exporters, atomic output · ``arrays`` (pfm, npy) · ``views`` · ``hci`` · ``dng``
the sensor values of a raw light field · ``sweep`` the parallax path that ``gif`` and ``webm`` follow. One file per
format; nothing here is imported until it is used.
"""
