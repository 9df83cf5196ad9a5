"""What binds every part of lfrig: errors and exit codes, the schemas of the files on disk, atomic writing.

Nothing here imports another part of lfrig. Rooms:

- ``errors``   the exception tree, each with its exit code, a one-line message and a remedy
- ``schema``   the base of all documents: frozen, validated, unknown fields kept, newer majors refused
- ``capture`` ``session`` ``result`` ``score`` ``truth`` ``bench``   one document each
- ``paths``    file names and view patterns that stay inside a capture's folder
- ``files``    atomic files and folders, hashes
- ``progress`` how long work reports its progress, its warnings, and hears of a cancel
- ``native``   where the native core is switched on and off
"""
