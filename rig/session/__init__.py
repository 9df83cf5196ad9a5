"""The session folder: what a rig shot or somebody brought, kept as it was.

``store`` the folder itself · ``images`` picture files, with named errors · ``views`` many of them into one volume ·
``raw_photo`` photos as the sensor saw them, through LibRaw · ``tiff_blocks`` whether their pixels are all there ·
``exif`` orientation and focal length · ``convert`` documents → nouns of `lfrig.processing.model` · ``rectify``
square pixels and lens distortion.
"""
