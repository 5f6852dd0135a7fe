"""The search that runs in the background from the layout as it stands, and the result that its best moves into."""

from typing import TYPE_CHECKING

from fabdesign.errors import InputError
from fabdesign.units import in_mm
from studies.studio.opening import search_limits
from studies.studio.results import Result
from studies.studio.searching import Search, Vary, next_folder, require_searchable

if TYPE_CHECKING:
    from studies.studio.session import Session


class BackgroundSearch:
    """At most one at a time."""

    def __init__(self, session: "Session") -> None:
        self._session = session
        self._under_way: tuple[Search, Result] | None = None

    @property
    def running(self) -> bool:
        return self._under_way is not None

    def start(self, vary: Vary, seconds: float) -> None:
        """What it finds is a drawing of its own. What is refused is told."""
        session = self._session
        if self.running or not session.targets.all:
            session.view.tell(
                "a search is running" if self.running else "no target; expected one to search for", bad=True
            )
            return
        try:
            search = self._begun(vary, seconds)
        except InputError as error:
            session.view.tell(str(error), bad=True)
            return
        number = search.folder.name.rpartition("_")[2]
        layouts = session.targets.layouts()
        result = Result(name=f"search {number}: {vary}", begun=layouts[0], layouts=layouts, state="searching")
        self._under_way = search, result
        session.drawings.add(result)
        session.view.show_search(f"searching in {search.folder.name}, the first evaluations", running=True)

    def _begun(self, vary: Vary, seconds: float) -> Search:
        session = self._session
        require_searchable(session.layout, vary)
        session.document.end()
        limits = session.limits if session.opened.targets else search_limits(session.layout.design)
        return Search(
            next_folder(session.files.folder), session.layout, session.targets.all, limits,
            vary=vary, seconds=seconds, model=session.model_file,
        )  # fmt: skip

    def stop(self) -> None:
        """The best so far stays."""
        if self._under_way is not None:
            self._under_way[0].stop()
            self._session.view.show_search("stopping, with the best so far", running=True)

    def follow(self) -> None:
        """Read what it has found, and whether it has ended."""
        if self._under_way is None:
            return
        search, result = self._under_way
        running = search.running  # before the result is read: what it wrote last is not missed
        if (best := search.best()) is not None:
            result.hold(best.layouts, best.objective)
            count = len(self._session.targets.all)
            of = "" if count == 1 else f", mean of {count} poses,"
            figure = f"{in_mm(best.objective):.2f} mm{of} after {best.evaluations} evaluations"
            result.state = f"{figure}; {best.stop_reason}"
            self._session.view.show_search(result.state, running=running)
            self._session.drawings.changed(result)
        if not running:
            self._ended(search, result)

    def _ended(self, search: Search, result: Result) -> None:
        view, problem = self._session.view, search.problem
        search.close()
        self._under_way = None
        view.show_search(problem or f"kept in {search.result}", running=False)
        if problem:
            result.state = problem
            view.tell(problem, bad=True)
        view.show_results()

    def close(self) -> None:
        """It ends with its best."""
        if self._under_way is not None:
            self._under_way[0].close()
