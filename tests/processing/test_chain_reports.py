"""Reports of a whole chain of runs, as they come from the computing."""

import pytest
from simulated_runs import SIZE_PX

from irpmd_rig.processing.process import reported
from irpmd_rig.report.reading import read_run
from irpmd_rig.report.run import run_page


@pytest.fixture(scope="module")
def pages(chain):
    return {kind: run_page(read_run(folder, chain.runs.library)) for kind, folder in chain.folders.items()}


def test_every_kind_of_run_has_a_page_with_an_answer_and_pictures(chain, pages):
    for kind, page in pages.items():
        assert page.title == chain.folders[kind].record().name
        assert page.verdict.passed is True, (kind, page.verdict)
        assert len(page.pictures) >= 3
        assert len({picture.name for picture in page.pictures}) == len(page.pictures)


def test_the_measured_steps_are_the_answer(chain, pages):
    content = chain.content("measure")
    headline = pages["measure"].verdict.headline
    for step in content["steps"]:
        assert f"{step['measured_mm']:.2f}"[:-1] in headline
    used = next(section for section in pages["measure"].sections if section.heading == "Calibrations used")
    assert {row[1] for row in used.blocks[0].rows} == set(content["uses"].values())


def test_frames_are_shown_where_the_camera_saw_them(pages):
    for page in pages.values():
        frames = next((picture for picture in page.pictures if picture.name == "frames"), None)
        assert frames.figure.axes[0].images[0].get_extent() == [-0.5, SIZE_PX - 0.5, SIZE_PX - 0.5, -0.5]


def test_the_report_is_the_last_of_the_results(chain):
    told = []
    folder, done = chain.folders["calibrate-camera"], chain.processed["calibrate-camera"]
    again = reported(done, folder, chain.runs.library, told.append)
    assert again.files[: len(done.files)] == done.files
    assert again.files[-1] == "report.html"
    assert [progress.file for progress in told[1:]] == list(again.files[len(done.files) :])
    for name in again.files[len(done.files) :]:
        folder.results.path(name).unlink()
