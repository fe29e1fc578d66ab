"""A part of the method: which one it is, and all of its settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from slgaussian.errors import InputError, did_you_mean
from slgaussian.parts.identity import CHANGED, KnownFile
from slgaussian.parts.registry import find_part
from slgaussian.parts.settings import Setting, check_settings, settings_of


@dataclass(frozen=True)
class Part:
    """A part with its settings, as what it makes depends on them; cheap to pass on and to pickle.

    Attributes
    ----------
    kind : str
        One of :data:`slgaussian.parts.registry.KINDS`.
    name : str
        By which the registry knows it.
    settings : mapping
        All that the part declares, those left out with their defaults, and what else was given for
        its class. A file, folder or model is a :class:`slgaussian.parts.identity.KnownFile`.
    """

    kind: str
    name: str
    settings: Mapping[str, Any]

    @staticmethod
    def of(kind: str, name: str, values: Mapping[str, Any] | None = None) -> Part:
        """The part with these values, files among them by place.

        Raises
        ------
        InputError
            If there is no such part, it has no such setting, a file cannot be read or a value
            cannot be written down. What is out of bounds is said by :meth:`load`.
        """
        part, values = find_part(kind, name), values or {}
        declared = _known(part, name, values)
        made = {key: setting.default for key, setting in declared.items()} | dict(values)
        for key, setting in declared.items():
            if setting.content is not None and made[key] is not None:
                try:
                    made[key] = KnownFile.at(made[key], setting.content)
                except (OSError, InputError) as error:
                    part(**values)  # which knows better what is wrong with its file
                    raise InputError(f"{name} {key} {made[key]}: {error}") from error
        found = Part(kind, name, made)
        try:
            json.dumps(found.identity())
        except TypeError as error:
            raise InputError(f"settings: {error}; give plain numbers and text") from None
        return found

    @staticmethod
    def stored(
        kind: str, identity: Mapping[str, Any], places: Mapping[str, str] | None = None
    ) -> Part:
        """The part of a kind that an artifact or a cache key names.

        Parameters
        ----------
        kind : str
        identity : mapping
            Of a whole method, as :meth:`slgaussian.parts.method.Method.identity` gives it, or of
            some of its parts: ``{"encoder": "clip", "clip": {"model": digest}}``.
        places : {setting: place}, optional
            Where its files are. One of which no digest is known may be any.

        Raises
        ------
        InputError
            If there is no such part, or it has no such setting.
        """
        name, places = identity[kind], places or {}
        part = find_part(kind, name)
        # What is no setting any more and was not set never mattered.
        stored = identity.get(name, {}).items()
        own = {key: v for key, v in stored if v is not None or key in settings_of(part)}
        declared = _known(part, name, {**own, **places})
        for key, setting in declared.items():
            place, digest = places.get(key), own.get(key)
            if setting.content is not None and not place is digest is None:
                own[key] = KnownFile("" if place is None else str(place), digest)
        return Part(kind, name, own)

    @property
    def implementation(self) -> Any:
        """The class or function that the name stands for."""
        return find_part(self.kind, self.name)

    def identity(self) -> dict[str, Any]:
        """The settings as artifacts and cache keys hold them: plain, files by content."""
        return {
            key: value.digest if isinstance(value, KnownFile) else value
            for key, value in self.settings.items()
        }

    def places(self) -> dict[str, str]:
        """Where its files are, by the name of the setting."""
        return {key: known.place for key, known in self.files.items() if known.place}

    def values(self, otherwise: str = CHANGED) -> dict[str, Any]:
        """The settings, files by place; InputError as :meth:`load`."""
        declared = settings_of(self.implementation)
        files = {
            key: known.checked(key, content, otherwise)
            for key, known in self.files.items()
            if (content := declared[key].content) is not None
        }
        return {**self.settings, **files}

    def load(self, otherwise: str = CHANGED) -> Any:
        """The part, ready to work.

        Raises
        ------
        InputError
            If a file is no longer the one that is known, of which ``otherwise`` is said; or as the
            part.
        """
        try:
            made = self.implementation(**self.values(otherwise))
        except TypeError as error:
            raise InputError(f"settings of {self.name!r}: {error}") from None
        check_settings(made, self.name)
        return made

    @property
    def files(self) -> dict[str, KnownFile]:
        """The files, folders and models among its settings."""
        return {key: v for key, v in self.settings.items() if isinstance(v, KnownFile)}


def _known(part: Any, name: str, values: Mapping[str, Any]) -> dict[str, Setting]:
    """The declared settings of a part's class; InputError if ``values`` has another key."""
    own = [field.name for field in fields(part) if field.init] if is_dataclass(part) else []
    for key in values:
        if key not in own:
            near = did_you_mean(key, own)
            listed = ", ".join(settings_of(part)) or "none"
            raise InputError(
                f"settings of {name!r}: found {key!r}{near or f', expected some of: {listed}'}"
            )
    return settings_of(part)
