"""The page put together: summary, answers, figures, tables, failures, trials, how it was made."""

import base64
import hashlib
from importlib.resources import files
from typing import Final

from evaluation.metrics import Direction
from evaluation.study_report import figures, tables, time_figures
from evaluation.study_report.contents import Contents
from evaluation.study_report.markup import Markup, element, joined
from evaluation.study_report.paper_figures import paper_figures
from evaluation.study_report.questions import answers
from evaluation.study_report.sentences import summary
from evaluation.study_report.trial_data import trial_data

# Trials are thinned so that the page stays below 5 MB.
_MOST_BYTES: Final = 4_800_000
_SECTIONS: Final = {
    "summary": "Summary",
    "answers": "Answers",
    "figures": "Figures",
    "paper": "The paper's figures",
    "tables": "Tables",
    "failures": "Failures",
    "trials": "Trials",
    "made": "How it was made",
}
_TERMS: Final = (
    ("interval", "95 % percentile bootstrap over the seeds; none below six seeds"),
    ("difference", "of two estimators on the same measurements; seeds that lack one are left out"),
    ("better", "Wilcoxon's signed ranks, two-sided, p below 0.05 after Holm over all differences "
     "in that metric in the study, and an interval that is not on both sides of 0; else no "
     "difference can be shown, which is not the same as there being none"),
    ("path error", "ATE: the estimated path laid rigidly onto the true one, RMSE of the distance"),
    ("path error as told at the time", "of each pose as it was told before the next measurement: "
     "graphs (smoothed, plain-isam2) correct earlier poses later, which counts in the path error; "
     "filters do not, and both of theirs are the same"),
    ("drift", "the largest distance with the first pose laid onto the first true one"),
    ("landmark error", "the map laid rigidly onto the true one, RMSE of the distance"),
    ("NEES", "squared error of a pose in units of its own covariance; its degrees of freedom are "
     "expected"),
    ("told more", "the oracle knows the true associations, particle-filter and combined the true "
     "map; they are shown beside the others and win nothing"),
    ("oracle", "the batch optimum with true associations: what the data allow"),
)  # fmt: skip


def page(contents: Contents) -> str:
    """The whole HTML file."""
    style, script = _asset("page.css"), _asset("page.js")
    sections = {name: content for name, content in _sections(contents).items() if content}
    policy = (
        f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        Markup(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"Study {contents.name}"),
        element("style", style),
    )
    main = element("main", _header(contents, list(sections)), *_rendered(sections), id="study")
    room = _MOST_BYTES - len((style + script + main).encode())
    body = element(
        "body",
        main,
        Markup('<article id="trial" hidden aria-live="polite"></article>'),
        element("script", Markup(trial_data(contents, room)), type="application/json", id="data"),
        element("script", script),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def _sections(contents: Contents) -> dict[str, list[Markup]]:
    is_papers = contents.name == "paper"
    return {
        "summary": summary(contents) + _lead_figures(contents),
        "answers": answers(contents) if is_papers else [],
        "figures": _figures(contents),
        "paper": _grid(paper_figures(contents)),
        "tables": _tables(contents),
        "failures": [tables.failure_table(contents)],
        "trials": _trials(contents),
        "made": _made(contents),
    }


def _header(contents: Contents, sections: list[str]) -> Markup:
    links = [element("li", element("a", _SECTIONS[name], href=f"#{name}")) for name in sections]
    return element(
        "header",
        element("h1", f"Study {contents.name}"),
        element("p", contents.what, class_="lead"),
        element("nav", element("ul", *links), aria_label="Sections"),
    )


def _rendered(sections: dict[str, list[Markup]]) -> list[Markup]:
    return [
        element("section", element("h2", _SECTIONS[name]), *content, id=name)
        for name, content in sections.items()
    ]


def _lead_figures(contents: Contents) -> list[Markup]:
    primary = contents.primary
    if primary is None:
        return []
    measured = [each for each in contents.conditions if contents.ranked(each, primary)]
    if not measured:
        return []
    across = figures.across_conditions(contents, primary)
    return _grid([across, *_leading(contents, measured[0])])


def _leading(contents: Contents, condition: str) -> list[Markup | None]:
    primary = contents.primary
    if primary is None:
        return []
    return [
        figures.medians(contents, condition, primary),
        figures.cost_over_accuracy(contents, condition, primary),
    ]


def _figures(contents: Contents) -> list[Markup]:
    """All charts of a condition together; of further conditions folded away."""
    primary = contents.primary
    if primary is None:
        return []
    conditions = [each for each in contents.conditions if contents.ranked(each, primary)]
    if len(conditions) == 1:
        return _grid(_charts(contents, conditions[0]))
    return [
        element(
            "details",
            element("summary", condition),
            *_grid(_charts(contents, condition)),
            open="" if number == 0 else None,
        )
        for number, condition in enumerate(conditions)
    ]


def _charts(contents: Contents, condition: str) -> list[Markup | None]:
    primary = contents.primary
    if primary is None:
        return []
    others = [
        each
        for each in contents.headlines
        if each.name in ("heading_rmse_deg", "map_rmse_m") and contents.ranked(condition, each)
    ]
    is_first = condition == contents.conditions[0]
    return [
        time_figures.errors_over_time(contents, condition),
        figures.boxes(contents, condition, primary),
        figures.ecdfs(contents, condition, primary),
        figures.nees(contents, condition),
        time_figures.nees_over_time(contents, condition),
        *([] if is_first else _leading(contents, condition)),
        *[figures.boxes(contents, condition, each) for each in others],
    ]


def _tables(contents: Contents) -> list[Markup]:
    if not contents.headlines:
        return []
    found: list[Markup] = []
    for condition in contents.conditions:
        found.append(tables.headline_table(contents, condition))
        differing = [
            tables.difference_table(contents, condition, metric)
            for metric in contents.headlines
            if metric.better is not Direction.NEITHER
        ]
        found.append(_folded(f"Differences of each two estimators, {condition}", *differing))
        every = tables.all_metrics_table(contents, condition)
        found.append(_folded(f"Every metric, {condition}", every))
    return found


def _trials(contents: Contents) -> list[Markup]:
    needs = element("noscript", element("p", "A page for each trial needs JavaScript."))
    shown = [
        _folded(f"{condition}: each trial", tables.trial_table(contents, condition))
        for condition in contents.conditions
    ]
    return [needs, *shown]


def _made(contents: Contents) -> list[Markup]:
    terms = joined(
        joined([element("dt", term), element("dd", meaning)]) for term, meaning in _TERMS
    )
    commands = contents.run_again, contents.one_again.replace("{id}", "ID"), "semgraph report ."
    versions = sorted({pair for each in contents.outcomes for pair in each.versions})
    used = joined(
        joined([element("dt", name), element("dd", version)]) for name, version in versions
    )
    return [
        element("h3", "Run it again"),
        element(
            "p",
            "In the folder of this page: the study from the start, one trial alone, and "
            "this page from the files.",
        ),
        element("pre", "\n".join(commands)),
        element("h3", "Versions"),
        element("dl", used),
        element("h3", "Terms"),
        element("dl", terms),
        element("h3", "The study's file"),
        element("pre", contents.settings),
    ]


def _grid(drawn: list[Markup | None] | list[Markup]) -> list[Markup]:
    kept = [each for each in drawn if each is not None]
    return [element("div", *kept, class_="figures")] if kept else []


def _folded(title: str, *content: Markup) -> Markup:
    return element("details", element("summary", title), *content)


def _asset(name: str) -> Markup:
    return Markup(files("evaluation.study_report").joinpath(name).read_text(encoding="utf-8"))


def _hash(text: str) -> str:
    """As a content security policy names the one inline script or style it allows."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
