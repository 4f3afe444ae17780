"""The live page: a motion that is planned while its goal is dragged.

It has three parts, each of which depends only on the parts before it. The model is
plain data without a viewer: a :class:`~tominpmp.app.request.Request` is the input of
the user, an :class:`~tominpmp.app.planning.Outcome` the result. The controller plans in
a separate process and abandons outdated requests. The view shows both in the browser.
"""
