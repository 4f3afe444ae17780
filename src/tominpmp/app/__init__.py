"""The live page: a motion that is planned while its goal is dragged.

Three parts, each of which knows only those before it. The model is plain data without a
viewer: a :class:`~tominpmp.app.request.Request` is what was asked for, an
:class:`~tominpmp.app.planning.Outcome` what was found. The controller plans in a
process of its own and leaves off what is out of date. The view shows both in the
browser.
"""
