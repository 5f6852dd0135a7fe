"""Two tabs on one studio, in a real browser."""

from tests.browser import Page
from tests.studio.test_studio_browser import WAIT, edge, exact, holds, page, pytestmark  # noqa: F401 a fixture, and what skips

SECOND_TAB = """(() => {
  const frame = document.createElement('iframe');
  frame.id = 'second', frame.src = location.href;
  frame.style = 'position:fixed; left:0; top:0; width:760px; height:300px; z-index:-1';
  document.body.append(frame);
})()"""  # another client of the server
TEXT_THERE = "document.getElementById('second').contentDocument.body?.innerText"


def test_two_tabs_show_the_same_and_one_may_close(page: Page) -> None:  # noqa: F811 the fixture
    page.wait(exact(), seconds=WAIT)
    flat = edge(page)
    page.run(SECOND_TAB)
    page.wait(f"(text => text && text.includes({flat!r}))({TEXT_THERE})", seconds=WAIT)
    page.fill("Channel 0, kPa", "250", 0)
    page.wait(exact(other_than=flat), seconds=WAIT)
    page.wait(f"(text => text && text.includes({edge(page)!r}))({TEXT_THERE})", seconds=WAIT)
    page.run("document.getElementById('second').remove()")
    page.fill("End 1", "45")
    page.wait(f"{exact()} && {holds('all kept')}", seconds=WAIT)
