"""Ask an image of object ids for words: find, locate, segment, and say what is there.

Every answer is one number an object, spread over the image by id; no pixel is scored on its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import short
from slgaussian.language import Encoder, langsplat
from slgaussian.language.bank import MemoryBank
from slgaussian.language.class_evidence import evidence, log_probability
from slgaussian.language.confidence import OFTEN, USUAL, Confidence, confidence, signs
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.relevancy import ABSENT, SOFT, Scorer, check_temperature, sigmoid
from slgaussian.language.taught import TaughtWords, normal, spelled
from slgaussian.language.wholes import LEAST_PIXELS, NEAR_BEST, Candidates, near_best

AS_GOOD = 0.9
"""The largest of the objects whose gap reaches this fraction of the best gap is pointed at."""

PROTOCOLS = ("slgaussian", "langsplat")

PHRASES = {"lerf": ("object", "things", "stuff", "texture")}
"""Canonical phrases by name: LERF's, which LangSplat and the paper use too."""

CLASS_LEAD = 0.1
"""Lead in cosine that classes give a look at most, where the text is a noun alone. Fitted, with the
next two, on labelled photographs: of any place left out the others choose nearly the same."""

CLASS_SCALE = 3.0
"""Nats of evidence for classes that give three quarters of that lead."""

DESCRIBED = 0.5
"""Each word that describes the noun counts this much of it: a described thing is less told by what
it is called."""

NAMED = 10.0
"""Gap of an object that the user called so, and minus it that of all others: far beyond cosines, so
that the relevancy is 1 or 0 at any temperature in use."""

REMEMBERED = 4096
"""Texts whose vectors a reader keeps."""


@dataclass(frozen=True)
class Rules:
    """Rules by which a text becomes an answer.

    Attributes
    ----------
    protocol : str
        ``slgaussian``: whole objects are selected, and the best one is pointed at. ``langsplat``:
        mask and point come from the smoothed relevancy image; see
        :mod:`slgaussian.language.langsplat`. Relevancies are the same.
    threshold : float in [0, 1), optional
        Absolute: select every object whose relevancy is above it, as the paper does. It means
        something else at every temperature, unless it is 0.5, or 0, which selects all.
    share : float in (0, 1]
        Without a threshold, relative and the same at all temperatures: objects above 0.5 whose gap
        to the canonical phrases is at least this share of the best object's gap fit about as well.
        These together, one object or a whole of several are selected, whichever ranks first
        (:mod:`slgaussian.language.wholes`); always these, and none if no object fits better
        than "object" does, where a bank knows no wholes or that was not measured: of an encoder
        without a ranking, with canonical phrases of one's own, by names and examples.
    temperature : float
        Of the relevancy; changes its scale, never the order of objects.
    canonical : str or sequence of str, optional
        The phrases that a text competes with; one string is a name in :data:`PHRASES`, or phrases
        with commas between them. Those of the encoder if left out.
    absent : str
        ``skip`` or ``zero``, the paper's zero vector; see
        :data:`slgaussian.language.relevancy.ABSENT`.

    Raises
    ------
    InputError
        If one of them is out of range, or a threshold is given to ``langsplat``, which has its own.
    """

    protocol: str = "slgaussian"
    threshold: float | None = None
    share: float = NEAR_BEST
    temperature: float = 10.0
    canonical: str | Sequence[str] | None = None
    absent: str = "skip"

    def __post_init__(self) -> None:
        check_temperature(self.temperature)
        for name, choices in (("protocol", PROTOCOLS), ("absent", ABSENT)):
            number = getattr(self, name)
            if number not in choices:
                raise InputError(
                    f"{name}: found {number!r}, expected one of {', '.join(choices)}"
                    f"{did_you_mean(number, choices)}"
                )
        if self.threshold is not None and not 0 <= self.threshold < 1:
            raise InputError(
                f"threshold: found {self.threshold}, expected a number from 0 to below 1"
            )
        if not 0 < self.share <= 1:
            raise InputError(f"share: found {self.share}, expected a number above 0, at most 1")
        if self.protocol == "langsplat" and self.threshold is not None:
            raise InputError(
                "threshold: the protocol langsplat has its own; leave out one of the two"
            )
        if self.phrases is not None and not all(self.phrases):
            raise InputError(
                f"canonical: found {self.canonical!r}, expected a name ({', '.join(PHRASES)}) or "
                "phrases with commas between them, none empty"
            )

    @property
    def phrases(self) -> tuple[str, ...] | None:
        """The canonical phrases; None stands for the encoder's own."""
        if self.canonical is None:
            return None
        if not isinstance(self.canonical, str):
            return tuple(self.canonical) or ("",)
        split = tuple(phrase.strip() for phrase in self.canonical.split(","))
        return PHRASES.get(self.canonical, split)

    @property
    def selection(self) -> str:
        """Way of selecting objects: ``near-best``, ``threshold`` or ``langsplat``."""
        if self.protocol == "langsplat":
            return "langsplat"
        return "near-best" if self.threshold is None else "threshold"


@dataclass(frozen=True)
class Understood:
    """The words of a text as an encoder reads them.

    Attributes
    ----------
    read_as : str
        Those that count, in words of the encoder.
    unknown : tuple of str
        Those that it does not know and leaves out.
    unused : {word: why}
        Others that do not count, though it may know them: "plant" of "plant pot".
    kind : str
        ``known``: the encoder answers, and knows every word that counts. ``unknown``: it answers,
        but there are words that it does not know and leaves out. ``taught``: the text is a word
        that a user taught, and its examples answer. ``picture``: a picture or an object was asked
        for, no text.
    examples : int
        Of a taught word, how many examples answer.
    instead_of : str
        Of a name or a taught word that the encoder knows too: what it would have read.
    measurements : int
        How many the text asks for, or as many as most do where nobody counts them.
    named : float
        By how much the classifier names some object so; see
        :class:`slgaussian.language.confidence.Signs`.
    describing : int
        How many words describe the noun.
    untold : str
        Why nothing can be said of what the text asks for; empty if something can.
    question : str
        Known words that may be meant by unknown ones, as the end of a sentence.
    """

    read_as: str
    unknown: tuple[str, ...]
    unused: Mapping[str, str]
    kind: str = "known"
    examples: int = 0
    instead_of: str = ""
    measurements: int = USUAL
    named: float = 0.0
    describing: int = 0
    untold: str = ""
    question: str = ""

    @property
    def alone(self) -> str:
        """That unknown words are left out, as the end of a sentence; empty if none is."""
        return f", for {self.read_as!r} alone{self.question}" if self.unknown else ""


class TextReader:
    """An encoder that remembers what it read.

    Texts are encoded one by one, so that an answer does not depend on what else is asked.
    """

    by_class = False
    """Whether a classifier has seen what is asked about."""

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        self._read = lru_cache(REMEMBERED)(self._encode)

    def vectors(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C] of texts.

        Raises
        ------
        InputError
            If there is no text, or the encoder cannot use one.
        """
        if isinstance(texts, str) or not len(texts):
            problem = "one text" if isinstance(texts, str) else "no text"
            raise InputError(f"query: found {problem}, expected a list of at least one")
        return np.stack([self._read(text)[0] for text in texts])

    def phrases(self, rules: Rules) -> tuple[str, ...]:
        """The canonical phrases that ``rules`` ask for."""
        return rules.phrases or tuple(self.encoder.canonical)

    def understood(self, text: str) -> Understood:
        """Read ``text``: what counts and what does not; InputError if the encoder cannot use it."""
        return self._read(text)[1]

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that the encoder leaves out, as it does not know them."""
        return self._read(text)[1].unknown

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        encoder = self.encoder
        untold = getattr(encoder, "untold", lambda *_: "")(text, self.by_class)
        read_as, unknown = encoder.read_as(text), encoder.unknown_words(text)
        # Of what nothing is known, nothing is said: as much as any phrase.
        vector = encoder.encode_text([text if read_as or not untold else encoder.canonical[0]])[0]
        return vector, Understood(
            read_as,
            unknown,
            encoder.unused_words(text),
            "unknown" if unknown else "known",
            measurements=getattr(encoder, "measurements", lambda _: USUAL)(text),
            describing=getattr(encoder, "describing", lambda _: 0)(text),
            untold=untold,
            question=getattr(encoder, "question", lambda _: "")(text) if unknown else "",
        )


class BankReader(TextReader):
    """A memory bank and the encoder that built it: what objects have to say to texts.

    What the canonical phrases score is remembered too. A text that is one of the ``names`` {id:
    name} means the objects called so and no others; one of the ``taught`` words is answered by
    their examples.
    """

    def __init__(
        self,
        bank: MemoryBank,
        encoder: Encoder,
        taught: TaughtWords | None = None,
        names: Mapping[int, str] | None = None,
    ) -> None:
        super().__init__(encoder)
        self.bank = bank
        self.by_class = bank.class_scores is not None
        self._present = bank.nodes[1]
        self.taught = TaughtWords() if taught is None else taught
        self._called: dict[str, list[int]] = {}
        for id_, name in (names or {}).items():
            self._called.setdefault(spelled(name), []).append(id_)
        self._scorer = lru_cache(4)(self._make_scorer)

    def gaps(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Relevancy gaps float64 [Q, N] of texts to the objects of the bank.

        Raises
        ------
        InputError
            If there is no text, or the encoder cannot use one.
        """
        scorer = self._scorer(self.phrases(rules), rules.absent)
        if isinstance(texts, str) or not len(texts):
            self.vectors(texts)  # which says what is wrong
        gaps = np.empty((len(texts), len(self.bank)))
        rows: dict[str, list[int]] = {"named": [], "taught": [], "known": []}
        for k, text in enumerate(texts):
            rows[self._who(text)].append(k)
        if rows["known"]:
            encoded = [texts[k] for k in rows["known"]]
            class_leads = np.stack([self.class_leads(text)[self._present] for text in encoded])
            gaps[rows["known"]] = scorer.gaps(self.vectors(encoded), class_leads)
        if rows["taught"]:
            leads = [self.taught.leads(texts[k], scorer.looks) for k in rows["taught"]]
            gaps[rows["taught"]] = scorer.combined(np.stack(leads))
        for k in rows["named"]:
            mine = np.isin(self.bank.ids, self._called[spelled(texts[k])])
            gaps[k] = np.where(mine, NAMED, -NAMED)
        return gaps

    def class_leads(self, text: str) -> np.ndarray:
        """Compute what the classifier adds to the leads of a text, float64 [M, V].

        Zero where the noun is none of its classes, or nothing was classified.
        """
        strength = CLASS_LEAD / (1 + DESCRIBED * super().understood(text).describing)
        leads: np.ndarray = strength * np.tanh(self.class_evidence(text) / CLASS_SCALE)
        return leads

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        vector, read = super()._encode(text)
        likeliest = self._likeliest(text)
        return vector, read if likeliest is None else replace(read, named=likeliest - OFTEN)

    def _likeliest(self, text: str) -> float | None:
        """Log-probability of the noun's classes in the object that has most of it."""
        classes = getattr(self.encoder, "classes", lambda _: ())(text)
        if not classes or self.bank.class_scores is None or not self.bank.present.any():
            return None
        objects = self.bank.class_scores[: len(self.bank)][self.bank.present]
        return float(log_probability(objects, classes).max())

    def class_evidence(self, text: str) -> np.ndarray:
        """Compute how much likelier the noun's classes are there than in whole photographs, nats.

        float64 [M, V] over ``bank.nodes``, see :func:`slgaussian.language.class_evidence.evidence`;
        zeros if there are none, or nothing was classified. InputError if the text cannot be used.
        """
        bank = self.bank
        classes = getattr(self.encoder, "classes", lambda _: ())(text)
        if not classes or bank.class_scores is None or bank.photograph_scores is None:
            return np.zeros(self._present.shape)
        return evidence(bank.class_scores, bank.photograph_scores, classes)

    def relevancies(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Relevancies float64 [Q, N] in [0, 1] of texts to the objects; errors as :meth:`gaps`."""
        relevancies: np.ndarray = sigmoid(rules.temperature * self.gaps(texts, rules))
        return relevancies

    def chosen(
        self, texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, rules: Rules
    ) -> np.ndarray:
        """Choose the objects of answers, bool [Q, N].

        Parameters
        ----------
        texts : sequence of str
        gaps : float64 [Q, N]
            Their gaps; -inf is what cannot be meant.
        areas : int64 [N]
            Pixels of each object in the view that is asked.
        rules : Rules
        """
        if rules.threshold is not None:
            above: np.ndarray = gaps > _least_gap(rules)
            return above
        best = gaps.max(1, where=areas > 0, initial=-np.inf, keepdims=True)
        chosen = near_best(gaps, best, rules.share)
        wholes, ranking = self.bank.wholes, getattr(self.encoder, "ranking", None)
        ranked = [k for k, text in enumerate(texts) if self._who(text) == "known"]
        if ranked and wholes and ranking and not unmeasured(self.encoder, rules):
            known = [texts[k] for k in ranked]
            chosen[ranked] = self.candidates(known, gaps[ranked], areas, rules).best(ranking)
        return chosen

    def candidates(
        self, texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, rules: Rules
    ) -> Candidates:
        """Describe what may be the answers to texts of known words; arguments as :meth:`chosen`."""
        assert self.bank.wholes is not None
        plain = self._scorer(self.phrases(rules), rules.absent).gaps(self.vectors(texts))
        plain = np.where(gaps > -np.inf, plain, -np.inf)
        evidence = np.stack([self.class_evidence(text)[: len(self.bank)] for text in texts])
        return self.bank.wholes.candidates(plain, evidence, areas, rules.share)

    def understood(self, text: str) -> Understood:
        """Read ``text``: what counts and what does not; InputError if nothing can use it."""
        who = self._who(text)
        if who == "known":
            return super().understood(text)
        try:
            also = super().understood(text)
            instead_of = "" if also.unknown else also.read_as
        except InputError:
            instead_of = ""
        word = normal(text)
        examples = self.taught.examples(word) if who == "taught" else 0
        return Understood(word, (), {}, who, examples, instead_of)

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that are left out; InputError as :meth:`understood`."""
        return self.understood(text).unknown

    def _who(self, text: str) -> str:
        """Name what answers: a name wins over a taught word, and that over the encoder."""
        if spelled(text) in self._called:
            return "named"
        return "taught" if text in self.taught else "known"

    def _make_scorer(self, phrases: tuple[str, ...], absent: str) -> Scorer:
        for phrase in phrases:
            if untold := super().understood(phrase).untold:
                raise InputError(f"canonical phrase {phrase!r}: {untold}")
        canonical = self.vectors(phrases)
        soft = getattr(self.encoder, "soft", SOFT)
        return Scorer(*self.bank.nodes, canonical, absent, self.bank.levels, soft)


@dataclass(frozen=True, eq=False)
class QueryResult:
    """The answer to a text in one image. Pictures are drawn when they are first looked at.

    Attributes
    ----------
    text : str
    scores : float64 [N]
        Relevancy of every object of the bank in [0, 1], whether the image shows it or not.
    understood : Understood
        Which words of the text count.
    """

    text: str
    scores: np.ndarray
    understood: Understood
    _ids: np.ndarray = field(repr=False)
    _seen: ObjectMap = field(repr=False)
    _ranked: np.ndarray = field(repr=False)
    """Places in the bank of the visible objects that some view holds, best first."""
    _as_good: np.ndarray = field(repr=False)
    """Places of those that the point may be on: about as good as the best of the answer."""
    _chosen: np.ndarray = field(repr=False)
    """bool [N]: what the rules select, visible or not."""
    confidence: Confidence | None = None
    """How likely mask and point are right; None where that was not measured: of an encoder without
    a calibration, with canonical phrases of one's own, or by the protocol ``langsplat``. And of a
    name, of which nothing is to be doubted."""
    uncalibrated: str = ""
    """For what that was not measured, such as ``the encoder clip``; empty where it was, or where
    nothing is to be doubted."""

    def __repr__(self) -> str:
        ids = short([id_ for id_, _ in self.objects])
        summary = f"{self.verdict}, score {self.score:.3f}, objects {ids}"
        return f"{type(self).__name__}({self.text!r}: {summary})"

    @property
    def kind(self) -> str:
        """Source of the answer: ``known``, ``named``, ``taught`` and so on."""
        return self.understood.kind

    @property
    def unknown(self) -> tuple[str, ...]:
        """Words of the text that the encoder does not know and left out."""
        return self.understood.unknown

    @property
    def score(self) -> float:
        """Relevancy of the best visible object; 0.5 is "as good as any phrase". 0 without one."""
        return float(self.scores[self._ranked[0]]) if len(self._ranked) else 0.0

    @cached_property
    def objects(self) -> tuple[tuple[int, float], ...]:
        """The selected objects as (id, relevancy), best first; of equal ones the lowest id.

        By the protocol ``langsplat``, those that lie in the mask with more than half their pixels.
        """
        rows = self._ranked[self._selected[self._ranked]]
        return tuple((int(self._ids[i]), float(self.scores[i])) for i in rows)

    @cached_property
    def relevancy(self) -> np.ndarray:
        """float32 [H, W] in [0, 1]; 0 where there is no object."""
        return self._seen.spread(self.scores.astype(np.float32))

    @cached_property
    def mask(self) -> np.ndarray:
        """bool [H, W]: the pixels of the selected objects."""
        return self._seen.spread(self._chosen)

    @property
    def found(self) -> bool:
        """True if the :attr:`verdict` is ``found``."""
        return self.verdict == "found"

    @property
    def verdict(self) -> str:
        """``found``, ``not sure``, ``not here`` or ``cannot tell``: all that is told goes by this.

        Nothing can be told of a noun that nobody knows (:attr:`Understood.untold`). Else by
        :attr:`confidence`, see :class:`slgaussian.language.confidence.Confidence`; without it what
        selects anything is found. Mask and point are given whatever it says, as best guesses.
        """
        if self.understood.untold:
            return "cannot tell"
        if not self.mask.any():
            return "not here"
        return "found" if self.confidence is None else self.confidence.verdict

    @property
    def shown(self) -> bool:
        """True if mask and point are to be shown: the verdict is ``found`` or ``not sure``."""
        return self.verdict in ("found", "not sure")

    @property
    def summary(self) -> str:
        """The verdict and how likely it is, in one line: of terminal, JSON, picture and viewer.

        A page says the same (``summary`` of ``viewer/page/words.js``).
        """
        if self.understood.untold:
            return f"cannot tell: {self.understood.untold}"
        if not self.mask.any():
            why = f"the best object scores {self.score:.3f}"
            return f"not here: {why if len(self._ranked) else 'this view shows no object'}"
        if self.confidence is None:
            return f"found, uncalibrated for {self.uncalibrated}" if self.uncalibrated else "found"
        mask, point = self.confidence.mask, self.confidence.point
        if self.verdict == "not here":
            return f"probably not here: {point:.2f} that the best object is it"
        alone = self.understood.alone
        sure = f"{mask:.2f} that the mask is right, {point:.2f} that the point is"
        return f"{self.verdict}: {sure}{alone}"

    @property
    def point(self) -> tuple[int, int] | None:
        """Column and row (x, y) of the pixel that is the best guess of where the object is.

        Of the selected objects that fit about as well as the best of them does (:data:`AS_GOOD`),
        the one that the image shows most of: a sliver fits by chance more easily. The middle of
        where that one is thickest; see :func:`slgaussian.language.locate.central_point`. Given even
        if no object was good enough to be selected; None if the image shows none at all.
        """
        if not len(self._ranked):
            return None
        return self._seen.point(int(self._as_good[self._seen.areas[self._as_good].argmax()]))

    @cached_property
    def peak(self) -> np.ndarray:
        """bool [H, W]: all pixels where the relevancy is greatest, several objects if they tie."""
        return self._seen.spread((self.scores == self.score) & bool(len(self._ranked)))

    @property
    def _selected(self) -> np.ndarray:
        return self._chosen


class LangSplatResult(QueryResult):
    """A result whose mask, point and peak come from the smoothed relevancy image."""

    @cached_property
    def mask(self) -> np.ndarray:
        """bool [H, W]; see :func:`slgaussian.language.langsplat.find_mask`."""
        return langsplat.find_mask(self._filled)

    @property
    def point(self) -> tuple[int, int] | None:
        """(x, y); see :func:`slgaussian.language.langsplat.find_point`."""
        return self._place[0] if len(self._ranked) else None

    @property
    def peak(self) -> np.ndarray:
        """bool [H, W]: all pixels where the smoothed relevancy is greatest."""
        return self._place[1] & bool(len(self._ranked))

    @property
    def _selected(self) -> np.ndarray:
        return 2 * self._seen.areas_within(self.mask) > self._seen.areas

    @cached_property
    def _place(self) -> tuple[tuple[int, int], np.ndarray]:
        return langsplat.find_point(self._filled)

    @cached_property
    def _filled(self) -> np.ndarray:
        """Relevancy, the least of the image where there is no object: a hole must not stretch the
        range that the mask's threshold is a share of."""
        return self._seen.spread(self.scores, self.scores[self._ranked].min(initial=1.0))


def ask(
    texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules
) -> list[QueryResult]:
    """Find the objects that each text describes, among those that an image shows.

    Raises
    ------
    InputError
        If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    chosen = reader.chosen(texts, gaps, seen.areas, rules)
    return [_answer(*each, seen, reader, rules) for each in zip(texts, gaps, chosen, strict=True)]


def _answer(
    text: str,
    gaps: np.ndarray,
    chosen: np.ndarray,
    seen: ObjectMap,
    reader: BankReader,
    rules: Rules,
) -> QueryResult:
    """Answer a text by its gaps float64 [N], -inf is what cannot be meant, and the chosen [N]."""
    kind = LangSplatResult if rules.protocol == "langsplat" else QueryResult
    calibration = reader.encoder.calibration
    doubt = unmeasured(reader.encoder, rules)
    visible = np.flatnonzero(seen.areas)
    ranked = visible[np.argsort(-gaps[visible], kind="stable")]
    ranked = ranked[gaps[ranked] > -np.inf]
    as_good = ranked[chosen[ranked]] if chosen[ranked].any() else ranked
    best = gaps[as_good].max(initial=-np.inf)
    as_good = as_good[gaps[as_good] >= min(AS_GOOD * best, best)]
    scores = sigmoid(rules.temperature * gaps)
    read, sure = reader.understood(text), None
    why = "" if read.kind == "named" else doubt
    if calibration is not None and not doubt and len(ranked) and read.kind != "named":
        parts = seen.parts(chosen & (gaps > -np.inf))
        at = signs(gaps[ranked], chosen[ranked], read.measurements, parts, read.named)
        sure = confidence(calibration, at)
    selection = ranked, as_good, chosen, sure, why
    return kind(text, scores, read, reader.bank.ids, seen, *selection)


def unmeasured(encoder: Encoder, rules: Rules) -> str:
    """Name that for which it was not measured how often answers are right; empty if it was."""
    if encoder.calibration is None:
        return f"the encoder {encoder.name}"
    if rules.canonical is not None:
        return "canonical phrases of your own"
    return "" if rules.protocol == "slgaussian" else f"the protocol {rules.protocol}"


def _least_gap(rules: Rules) -> float:
    """Gap above which a text fits an object; 0, that of the canonical phrases, by default."""
    if not rules.threshold:
        return 0.0 if rules.threshold is None else -np.inf
    return float(np.log(rules.threshold) - np.log1p(-rules.threshold)) / rules.temperature


def find(
    text: str, reader: BankReader, rules: Rules, among: np.ndarray
) -> tuple[tuple[int, float], ...]:
    """The objects that a text describes, whatever the view: (id, relevancy), best first.

    ``among`` bool [N] are the objects of the bank that may be found. InputError as :func:`ask`.
    """
    gaps = np.where(among, reader.gaps([text], rules)[0], -np.inf)
    everywhere = np.where(among, LEAST_PIXELS, 0)
    matching = np.flatnonzero(reader.chosen([text], gaps[None], everywhere, rules)[0] & among)
    scores = sigmoid(rules.temperature * gaps)
    ranked = matching[np.argsort(-gaps[matching], kind="stable")]
    return tuple((int(reader.bank.ids[i]), float(scores[i])) for i in ranked)


def segment(texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules) -> np.ndarray:
    """Give every object the text that describes it best; the temperature cannot change which.

    Returns
    -------
    int32 [H, W]
        k + 1 where ``texts[k]`` has the highest relevancy; ties go to the first text. 0 where there
        is no object, or none of the texts has a relevancy above the threshold of ``rules``, 0.5 if
        that is left out.

    Raises
    ------
    InputError
        If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    winner = np.where(gaps.max(0) > _least_gap(rules), gaps.argmax(0) + 1, 0)
    return seen.spread(winner.astype(np.int32))


@dataclass(frozen=True)
class Description:
    """The best of some texts for one object.

    Attributes
    ----------
    id : int
        Of the object.
    text : str
        The text that describes it best; of equally good ones the first.
    relevancy : float
        In [0, 1]; up to 0.5 the canonical phrases say as much.
    views : tuple of int
        Numbers of the context views that hold the object.
    """

    id: int
    text: str
    relevancy: float
    views: tuple[int, ...]


def describe(texts: Sequence[str], reader: BankReader, rules: Rules) -> list[Description]:
    """Say what is there: every object of the bank with the best of the texts, by id.

    Raises
    ------
    InputError
        If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    scores = sigmoid(rules.temperature * gaps)
    bank = reader.bank
    return [
        Description(
            id=int(bank.ids[i]),
            text=texts[best],
            relevancy=float(scores[best, i]),
            views=tuple(map(int, np.flatnonzero(bank.present[i]))),
        )
        for i, best in enumerate(gaps.argmax(0))
    ]
