"""A configured component of the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slgaussian.components.registry import find_config
from slgaussian.errors import InputError
from slgaussian.io import CHANGED_FILE, KnownFile


@dataclass(frozen=True)
class Component:
    """A component with all settings that its results depend on; small and picklable.

    Attributes:
        kind: One of :data:`slgaussian.components.registry.KINDS`.
        name: Name in the registry.
        settings: All fields of its config, including defaults. Files, folders and models are
            :class:`slgaussian.io.KnownFile`.
    """

    kind: str
    name: str
    settings: Mapping[str, Any]

    @staticmethod
    def of(kind: str, name: str, values: Mapping[str, Any] | None = None) -> Component:
        """Return the component with these field values; files are given by their places.

        Raises:
            InputError: If the component or a field is unknown, a value is invalid, or a file cannot
                be read.
        """
        config = find_config(kind, name)
        checked = config(**(values or {}))
        settings = dict(checked)
        for key, file in config.files().items():
            if settings[key] is not None:
                try:
                    settings[key] = KnownFile.at(settings[key], file.digest)
                except (OSError, InputError) as error:
                    checked.load()  # its error message is more specific
                    raise InputError(f"{name} {key} {settings[key]}: {error}") from error
        return Component(kind, name, settings)

    @staticmethod
    def stored(
        kind: str, identity: Mapping[str, Any], places: Mapping[str, str] | None = None
    ) -> Component:
        """Return the component of a kind from the identity in an artifact or cache key.

        Args:
            identity: Identity of a method (:meth:`slgaussian.components.method.Method.identity`),
                or of some of its components: ``{"encoder": "clip", "clip": {"model": digest}}``.
            places: {field: place}, optional. Locations of its files. The content of a file without
                a stored digest is not checked.

        Raises:
            InputError: If the component or a field is unknown.
        """
        name, places = identity[kind], places or {}
        config = find_config(kind, name)
        # Fields that were removed from the config and had no value had no effect.
        stored = identity.get(name, {}).items()
        settings = {key: v for key, v in stored if v is not None or key in config.model_fields}
        if unknown := {**settings, **places}.keys() - config.model_fields.keys():
            config(**dict.fromkeys(unknown))  # raises InputError
        for key in config.files():
            place, digest = places.get(key), settings.get(key)
            if not place is digest is None:
                settings[key] = KnownFile("" if place is None else str(place), digest)
        return Component(kind, name, settings)

    @property
    def implementation(self) -> Any:
        """The class or function registered under the name."""
        return find_config(self.kind, self.name).implementation()

    def identity(self) -> dict[str, Any]:
        """Return the settings for artifacts and cache keys: plain data, files by digest."""
        return {
            key: value.digest if isinstance(value, KnownFile) else value
            for key, value in self.settings.items()
        }

    def places(self) -> dict[str, str]:
        """Return the locations of its files, by field."""
        return {key: known_file.place for key, known_file in self.files.items() if known_file.place}

    def values(self, otherwise: str = CHANGED_FILE) -> dict[str, Any]:
        """Return the settings, with files as places; InputError as in :meth:`load`."""
        marks = find_config(self.kind, self.name).files()
        places = {
            key: known_file.checked(key, marks[key].digest, otherwise)
            for key, known_file in self.files.items()
        }
        return {**self.settings, **places}

    def load(self, otherwise: str = CHANGED_FILE) -> Any:
        """Load the component.

        Raises:
            InputError: If the content of a file has changed, with message ``otherwise``; or by the
                component.
        """
        return self.implementation(**self.values(otherwise))

    @property
    def files(self) -> dict[str, KnownFile]:
        """The files, folders and models among its settings."""
        return {key: v for key, v in self.settings.items() if isinstance(v, KnownFile)}
