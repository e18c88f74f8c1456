"""A stub of viser without a server: it records messages, and knows how a browser would react to them."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

USER = object()
"""The browser of a user."""


class Handle:
    """An element of the page. Assignments are sent; after its removal they are errors, as in viser."""

    def __init__(self, server, kind, name, **given):
        vars(self).update(_server=server, _kind=kind, _name=name, _gone=False, _acts=[], **given)
        server.send("add", self)

    def __setattr__(self, name, value):
        if self._gone:
            raise RuntimeError(f"{self._name} is written to after it was removed")
        vars(self)[name] = value
        self._server.send("update", self, name)
        if name == "options" and self.value not in value:
            self.value = value[0]
        if name == "value":
            self._act(None)

    def remove(self):
        vars(self)["_gone"] = True
        self._server.send("remove", self)
        if self._kind == "scene":
            for other in self._server.handles:
                if other._kind == "scene" and other._name.startswith(f"{self._name}/"):
                    vars(other)["_gone"] = True

    def on_update(self, act):
        self._acts.append(act)

    on_click = on_update

    def _act(self, client):
        for act in self._acts:
            act(SimpleNamespace(client=client, target=self, phase="end"))

    def enter(self, value):
        """Set a value, as a user does in the browser."""
        vars(self)["value"] = value
        self._act(USER)

    def click(self):
        self._act(USER)

    def drag(self, place):
        """Drag the element to a position and release it."""
        vars(self)["position"] = place
        self._act(USER)

    def add_tab(self, name):
        return Handle(self._server, "gui", name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


class Gui:
    """Makes elements of the panel; the first argument of most of them is the label."""

    def __init__(self, server):
        vars(self).update(_server=server, main_panel=SimpleNamespace(dock_right=lambda: 0, set_width=lambda _: 0))

    def configure_theme(self, **_):
        return None

    def _add(self, name, **given):
        return Handle(self._server, "gui", name, **given)

    def add_slider(self, name, low, high, step, value, **given):
        return self._add(name, **{"min": low, "max": high, "step": step, "value": value, **given})

    def add_dropdown(self, name, options, initial_value=None, **given):
        return self._add(name, options=options, value=initial_value or options[0], **given)

    def add_number(self, name, value, **given):
        return self._add(name, value=value, **given)

    add_checkbox = add_vector3 = add_number

    def add_button(self, name, **given):
        return self._add(name, label=name, **given)

    def add_html(self, content):
        return self._add("html", content=content)

    def add_folder(self, name):
        return self._add(name)

    def add_tab_group(self):
        return self._add("tabs")

    def add_uplot(self, data, series, **given):
        return self._add("chart", data=data, series=series, **given)


class Space:
    """Makes nodes of the scene; a node replaces an earlier one of the same name."""

    def __init__(self, server):
        vars(self).update(_server=server)

    def __getattr__(self, what):
        if what.startswith("configure_"):
            return lambda *_, **__: None
        assert what.startswith("add_"), what
        return lambda name, *_, **given: Handle(self._server, "scene", name, **given)


class ViserServer:
    """Records what is sent to browsers that have not drawn anything yet."""

    def __init__(self, **_):
        self.sent, self.handles, self.watch = [], [], lambda *_: None
        self.gui, self.scene, self.complaints = Gui(self), Space(self), []
        self.initial_camera = SimpleNamespace()
        self.client = SimpleNamespace(
            add_notification=lambda title, body, **_: self.complaints.append(body), camera=SimpleNamespace()
        )

    def send(self, what, handle, name=""):
        self.watch(what, handle, name)
        if what == "add":
            self.handles.append(handle)
        self.sent.append((what, handle, name))

    def errors(self):
        """Return the browser's errors if all messages arrive between two frames.

        As in viser's client, elements are added and removed at once, and updates of panel elements are applied
        afterwards, to the elements that still exist.
        """
        there, late = set(), []
        for what, handle, name in self.sent:
            if handle._kind == "gui" and what == "update":
                late.append((handle, name))
            elif what != "update":
                (there.add if what == "add" else there.discard)(handle)
        return [f"{handle._name}.{name}" for handle, name in late if handle not in there]

    def only(self, kind, name):
        """Return the element of this name on the page."""
        (found,) = (one for one in self.handles if (one._kind, one._name, one._gone) == (kind, name, False))
        return found

    @contextlib.contextmanager
    def atomic(self):
        yield

    def on_client_connect(self, _):
        return None

    def get_clients(self):
        return {0: self.client}

    def get_host(self):
        return "127.0.0.1"

    def get_port(self):
        return 8080

    def stop(self):
        return None
