"""A component of the method, with the values of all its fields."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from slgaussian.components.config import ComponentConfig
from slgaussian.components.registry import find_config
from slgaussian.errors import InputError
from slgaussian.io import CHANGED, KnownFile


@dataclass(frozen=True)
class Component:
    """A component with its values, as its results depend on them; cheap to pass on and to pickle.

    Attributes
    ----------
    kind : str
        One of :data:`slgaussian.components.registry.KINDS`.
    name : str
        By which the registry knows it.
    settings : mapping
        All fields of its config, those left out with their defaults, and what else was given for
        its implementation. A file, folder or model is a :class:`slgaussian.io.KnownFile`.
    """

    kind: str
    name: str
    settings: Mapping[str, Any]

    @staticmethod
    def of(kind: str, name: str, values: Mapping[str, Any] | None = None) -> Component:
        """Return the component with these values, files among them by place.

        Raises
        ------
        InputError
            If there is no such component, it has no such field, a value does not fit, a file cannot
            be read or a value cannot be written down.
        """
        config, values = find_config(kind, name), values or {}
        beside = _fields_beside(config, values)
        checked = config(**{key: value for key, value in values.items() if key not in beside})
        settings = dict(checked) | {key: values[key] for key in beside}
        for key, file in config.files().items():
            if settings[key] is not None:
                try:
                    settings[key] = KnownFile.at(settings[key], file.digest)
                except (OSError, InputError) as error:
                    checked.load()  # which knows better what is wrong with its file
                    raise InputError(f"{name} {key} {settings[key]}: {error}") from error
        component = Component(kind, name, settings)
        try:
            json.dumps(component.identity())
        except TypeError as error:
            raise InputError(f"settings: {error}; give plain numbers and text") from None
        return component

    @staticmethod
    def stored(
        kind: str, identity: Mapping[str, Any], places: Mapping[str, str] | None = None
    ) -> Component:
        """Return the component of a kind that an artifact or a cache key names.

        Parameters
        ----------
        kind : str
        identity : mapping
            Of a whole method, as :meth:`slgaussian.components.method.Method.identity` gives it, or
            of some of its components: ``{"encoder": "clip", "clip": {"model": digest}}``.
        places : {field: place}, optional
            Where its files are. One of which no digest is known may be any.

        Raises
        ------
        InputError
            If there is no such component, or it has no such field.
        """
        name, places = identity[kind], places or {}
        config = find_config(kind, name)
        # What is no field any more and was not set never mattered.
        stored = identity.get(name, {}).items()
        settings = {key: v for key, v in stored if v is not None or key in config.model_fields}
        keys = {**settings, **places}
        unknown = keys.keys() - config.model_fields.keys() - set(_fields_beside(config, keys))
        if unknown:
            config(**dict.fromkeys(unknown))  # which refuses them
        for key in config.files():
            place, digest = places.get(key), settings.get(key)
            if not place is digest is None:
                settings[key] = KnownFile("" if place is None else str(place), digest)
        return Component(kind, name, settings)

    @property
    def implementation(self) -> Any:
        """The class or function that the name stands for."""
        return find_config(self.kind, self.name).implementation()

    def identity(self) -> dict[str, Any]:
        """Return the settings as artifacts and cache keys hold them: plain, files by content."""
        return {
            key: value.digest if isinstance(value, KnownFile) else value
            for key, value in self.settings.items()
        }

    def places(self) -> dict[str, str]:
        """Return where its files are, by field."""
        return {key: known_file.place for key, known_file in self.files.items() if known_file.place}

    def values(self, otherwise: str = CHANGED) -> dict[str, Any]:
        """Return the settings, files by place; InputError as :meth:`load`."""
        marks = find_config(self.kind, self.name).files()
        places = {
            key: known_file.checked(key, marks[key].digest, otherwise)
            for key, known_file in self.files.items()
        }
        return {**self.settings, **places}

    def load(self, otherwise: str = CHANGED) -> Any:
        """Return the component, ready to work.

        Raises
        ------
        InputError
            If a file is no longer the one that is known, of which ``otherwise`` is said; or as the
            component does.
        """
        return self.implementation(**self.values(otherwise))

    @property
    def files(self) -> dict[str, KnownFile]:
        """The files, folders and models among its settings."""
        return {key: v for key, v in self.settings.items() if isinstance(v, KnownFile)}


def _fields_beside(config: type[ComponentConfig], keys: Iterable[str]) -> list[str]:
    """Of some keys those that the implementation takes and the config has not, as a device."""
    unknown = [key for key in keys if key not in config.model_fields]
    accepted = getattr(config.implementation(), "model_fields", {}) if unknown else {}
    return [key for key in unknown if key in accepted]
