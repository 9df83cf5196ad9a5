"""report.html: one self-contained page with the pictures a person would rather look at than numbers.

``page`` puts a result's page together · ``depth_page`` that of one light field's disparity · ``score`` the section
that scoring fills in later · ``sections`` ``sources`` parts of the page · ``viewer`` (with ``renderers.js`` and
``viewer.js``) the draggable light field · ``slices`` which rows and planes to show · ``pictures`` arrays → embedded
images · ``charts`` ``overview`` inline SVG · ``words`` numbers as people say them · ``html`` elements that cannot
forget to escape · ``style.css``.
"""
