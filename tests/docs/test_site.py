"""The site: generated pages are current, it builds without a warning, links lead on."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import calib_pin
from documentation.__main__ import documents
from documentation.api_reference import TOPICS
from documentation.blocks import ROOT
from documentation.site import build

DOCS = ROOT / "docs"
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)#\s]*)(?:#([^)\s]+))?\)")


def test_generated_documents_are_current():
    """Where this fails, `scripts/document` writes them anew."""
    for name, text in documents().items():
        assert (DOCS / name).read_text() == text, name


def test_every_public_name_is_in_the_reference():
    names = [name for topic in TOPICS.values() for name in topic]
    assert sorted(names) == sorted(calib_pin.__all__)


def anchors(page: Path) -> set[str]:
    """What a link may lead to on a page, as GitHub names headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
    titles = re.findall(r"^#+ (.+)$", text, flags=re.M)
    bare = (re.sub(r"[^\w\- ]", "", title.lower()) for title in titles)
    return {title.replace(" ", "-") for title in bare}


@pytest.mark.parametrize("name", ["README.md", "CHANGELOG.md"])
def test_links_of_the_repository_lead_somewhere(name: str):
    page = ROOT / name
    for path, anchor in LINK.findall(page.read_text()):
        target = page.parent / path if path else page
        assert target.exists(), path
        assert not anchor or anchor in anchors(target), f"{path}#{anchor}"


@pytest.mark.needs("docs")
def test_formulas_become_mathml():
    from documentation.hooks import with_formulas

    text = "Of $`a_1`$:\n\n```math\n\\sum_i x_i\n```\n\n`$x`\n"
    found = with_formulas(text)
    assert found.count("<math") == 2 and "`$x`" in found and "```" not in found


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("site"))


@pytest.mark.slow
@pytest.mark.needs("docs")
def test_the_site_builds_without_a_warning(site: Path):
    pages = sorted(path.relative_to(DOCS) for path in DOCS.rglob("*.md"))
    assert len(pages) > 30
    for page in pages:
        assert (site / page.with_suffix(".html")).is_file(), page


@pytest.mark.slow
@pytest.mark.needs("docs")
def test_the_site_needs_no_network(site: Path):
    """Whatever a page loads lies beside it; links to other sites are followed only."""
    loads = re.compile(r'<(?:script|img|link|iframe)[^>]*(?:src|href)="(?://|https?:)')
    for page in site.rglob("*.html"):
        found = [
            match.group()
            for match in loads.finditer(page.read_text())
            if 'rel="canonical"' not in match.group()
        ]
        assert found == [], page


@pytest.mark.slow
@pytest.mark.needs("docs")
def test_a_link_that_leads_nowhere_is_told(tmp_path: Path):
    """The build fails where it should."""
    configuration = (ROOT / "scripts/documentation/mkdocs.yml").read_text()
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# Page\n\n[there](nowhere.md)\n")
    keys = ("site_name", "theme", "validation")
    kept = {key: yaml.safe_load(configuration)[key] for key in keys}
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(kept))
    with pytest.raises(RuntimeError, match=r"nowhere\.md"):
        build(tmp_path / "site", tmp_path / "mkdocs.yml")
