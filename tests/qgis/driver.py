"""Runs inside the Python of QGIS: algorithms, dialogs, models and pictures, as jobs of a JSON file.

``/usr/bin/python3 driver.py JOBS.json RESULTS.json``; the plug-in is found in the profile of HOME.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path

sys.path.insert(0, "/usr/share/qgis/python/plugins")
# the QGIS of a clean environment only: never that of a virtual environment
from qgis.core import (
    QgsApplication,
    QgsFeature,
    QgsGeometry,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsProcessingContext,
    QgsProcessingFeatureSourceDefinition,
    QgsProcessingFeedback,
    QgsProcessingModelAlgorithm,
    QgsProcessingModelChildAlgorithm,
    QgsProcessingModelChildParameterSource,
    QgsProcessingModelOutput,
    QgsProcessingModelParameter,
    QgsProcessingParameterFile,
    QgsProject,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QCoreApplication, QSize, Qt

APP = QgsApplication([], True)
QCoreApplication.setOrganizationName("QGIS")
QCoreApplication.setApplicationName("QGIS3")
QgsApplication.setPrefixPath("/usr", True)
QgsApplication.initQgis()
profile = Path(os.environ["HOME"]) / ".local/share/QGIS/QGIS3/profiles/default"
sys.path.insert(0, str(profile / "python/plugins"))

from processing.core.Processing import Processing  # noqa: E402
from processing.gui.Postprocessing import handleAlgorithmResults  # noqa: E402

Processing.initialize()
import georef_qgis  # noqa: E402

PLUGIN = georef_qgis.classFactory(None)
PLUGIN.initProcessing()
REGISTRY = QgsApplication.processingRegistry()


def algorithms(job):
    """Every algorithm with its parameters and outputs."""
    provider = REGISTRY.providerById("georef")
    return {
        "problem": provider.warningMessage(),
        "algorithms": {
            alg.name(): {
                "title": alg.displayName(), "group": alg.group(), "help": alg.shortHelpString(),
                "url": alg.helpUrl(), "icon": not alg.icon().isNull(),
                "parameters": {
                    p.name(): [p.type(), int(p.flags()), p.defaultValue()]
                    for p in alg.parameterDefinitions()
                },
                "outputs": {o.name(): o.type() for o in alg.outputDefinitions()},
            }
            for alg in provider.algorithms()
        },
    }  # fmt: skip


def run(job):
    """Run an algorithm as the toolbox does, layers included."""
    alg = REGISTRY.createAlgorithmById(job["id"])
    context, feedback = QgsProcessingContext(), QgsProcessingFeedback()
    context.setProject(QgsProject.instance())
    parameters = job["parameters"]
    fine, message = alg.checkParameterValues(parameters, context)
    if not fine:
        return {"ok": False, "refused": message, "log": message}
    if "cancel_after" in job:
        return cancelled(alg, parameters, context, feedback, job["cancel_after"])
    fractions = []
    feedback.progressChanged.connect(fractions.append)
    outputs, fine = alg.run(parameters, context, feedback)
    loaded = (
        handleAlgorithmResults(alg, context, feedback, parameters=parameters) if fine else False
    )
    layers = [node.layer() for node in QgsProject.instance().layerTreeRoot().findLayers()]
    told = [
        {"name": layer.name(), "valid": layer.isValid(), "crs": layer.crs().authid(),
         "renderer": layer.renderer().type() if layer.renderer() else "",
         "features": layer.featureCount() if hasattr(layer, "featureCount") else None}
        for layer in layers
    ]  # fmt: skip
    if not job.get("keep"):
        QgsProject.instance().clear()
    return {"ok": fine, "outputs": outputs, "loaded": loaded, "layers": told,
            "progress": fractions, "log": feedback.textLog()}  # fmt: skip


def cancelled(alg, parameters, context, feedback, after):
    """Cancel a run that is going on, as the button does; s until it has ended."""
    import threading

    pressed = []

    def press():
        pressed.append(time.monotonic())
        feedback.cancel()

    timer = threading.Timer(after, press)
    timer.start()
    outputs, fine = alg.run(parameters, context, feedback)
    ended = time.monotonic()
    timer.cancel()
    return {"ok": fine, "outputs": outputs, "log": feedback.textLog(),
            "took": ended - pressed[0] if pressed else None}  # fmt: skip


def model(job):
    """A saved model of two of our algorithms, the project handed on from one to the next."""
    made = QgsProcessingModelAlgorithm("test", "tests")
    made.addModelParameter(
        QgsProcessingParameterFile("folder", "Folder", QgsProcessingParameterFile.Behavior.Folder),
        QgsProcessingModelParameter("folder"),
    )
    source = QgsProcessingModelChildParameterSource
    first = QgsProcessingModelChildAlgorithm("georef:footprints")
    first.setChildId("first")
    first.addParameterSources("PROJECT", [source.fromModelParameter("folder")])
    second = QgsProcessingModelChildAlgorithm("georef:export_geojson")
    second.setChildId("second")
    second.addParameterSources("PROJECT", [source.fromChildOutput("first", "project_folder")])
    second.addParameterSources("layer", [source.fromStaticValue("footprints")])
    out = QgsProcessingModelOutput("written", "Written")
    out.setChildId("second")
    out.setChildOutputName("target")
    second.setModelOutputs({"written": out})
    for child in (first, second):
        made.addChildAlgorithm(child)
    # as a user keeps it
    assert made.toFile(job["file"])
    made = QgsProcessingModelAlgorithm()
    assert made.fromFile(job["file"])
    context, feedback = QgsProcessingContext(), QgsProcessingFeedback()
    parameters = {"folder": job["project"], "second:written": job["target"]}
    fine, message = made.checkParameterValues(parameters, context)
    outputs, ran = made.run(parameters, context, feedback)
    return {"ok": fine and ran, "message": message, "outputs": outputs, "log": feedback.textLog()}


def dialogs(job):
    """Dialog and batch dialog of every algorithm; a picture of some."""
    from processing.gui.AlgorithmDialog import AlgorithmDialog
    from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog

    told = {}
    for alg in REGISTRY.providerById("georef").algorithms():
        if alg.name() not in job.get("only", [alg.name()]):
            continue
        dialog = AlgorithmDialog(alg.create(), False, None)
        told[alg.name()] = [len(dialog.mainWidget().wrappers)]
        if alg.name() in job.get("pictures", {}):
            photograph(dialog, job, job["pictures"][alg.name()])
        dialog.close()
        batch = BatchAlgorithmDialog(alg.create(), None)
        told[alg.name()].append(batch.mainWidget().batchRowCount())
        batch.close()
    return {"dialogs": told}


def photograph(dialog, job, target):
    """Fill in a dialog and save a picture of it."""
    dialog.resize(*job["size"])
    for name, value in job["values"].items():
        dialog.mainWidget().wrappers[name].setParameterValue(value, QgsProcessingContext())
    dialog.setAttribute(Qt.WidgetAttribute.WA_DontShowOnScreen, True)
    dialog.show()
    for _ in range(20):
        APP.processEvents()
        time.sleep(0.02)
    dialog.grab().save(target)


def picture(job):
    """Draw the visible layers of the QGIS project."""
    root = QgsProject.instance().layerTreeRoot()
    names = job.get("without", [])
    layers = [
        n.layer() for n in root.findLayers() if n.isVisible() and n.layer().name() not in names
    ]
    settings = QgsMapSettings()
    settings.setLayers(layers)
    settings.setDestinationCrs(layers[-1].crs())
    settings.setOutputSize(QSize(*job["size"]))
    settings.setOutputDpi(job.get("dpi", 96))
    settings.setTransformContext(QgsProject.instance().transformContext())
    shown = next(layer for layer in layers if layer.name() == job["around"])
    box = QgsRectangle(shown.extent())
    if "where" in job:
        box = QgsRectangle()
        for feature in shown.getFeatures(job["where"]):
            box.combineExtentWith(feature.geometry().boundingBox())
    box.grow(job.get("margin", 0.0))
    settings.setExtent(box)
    rendering = QgsMapRendererParallelJob(settings)
    rendering.start()
    rendering.waitForFinished()
    rendering.renderedImage().save(job["target"])
    return {"errors": [str(error.message) for error in rendering.errors()],
            "order": [layer.name() for layer in layers]}  # fmt: skip


def echo(job):
    """Run a tool of a manifest of one's own whose program writes down its command line."""
    from georef_qgis.algorithm import GeorefAlgorithm
    from georef_qgis.tools import read_tool

    memory = QgsVectorLayer("Point?crs=EPSG:32617&field=size:double", "in memory", "memory")
    for number in range(3):
        feature = QgsFeature(memory.fields())
        feature.setGeometry(QgsGeometry.fromWkt(f"POINT({number} 2)"))
        memory.dataProvider().addFeatures([feature])
    QgsProject.instance().addMapLayer(memory)
    memory.selectByIds([2])
    chosen = {"memory": memory.id(),
              "selected": QgsProcessingFeatureSourceDefinition(memory.id(), True)}  # fmt: skip
    given = {k: chosen.get(v, v) if isinstance(v, str) else v for k, v in job["parameters"].items()}
    alg = GeorefAlgorithm(read_tool(job["tool"]), job["command"]).create()
    context, feedback = QgsProcessingContext(), QgsProcessingFeedback()
    context.setProject(QgsProject.instance())
    fine, message = alg.checkParameterValues(given, context)
    outputs, ran = alg.run(given, context, feedback) if fine else ({}, False)
    saved = None
    written = Path(job["written"])
    words = json.loads(written.read_text("utf-8")) if ran else []
    for word in words:
        if word.startswith("--points="):
            layer = QgsVectorLayer(word.partition("=")[2], "read again", "ogr")
            saved = [layer.featureCount(), layer.crs().authid()]
    QgsProject.instance().clear()
    types = {p.name(): p.type() for p in alg.parameterDefinitions()}
    return {"ok": ran, "message": message, "words": words, "saved": saved, "types": types,
            "log": feedback.textLog(), "outputs": outputs}  # fmt: skip


def reload(job):
    """Take the plug-in away and load it again, as the plug-in manager does."""
    global PLUGIN
    PLUGIN.unload()
    gone = REGISTRY.providerById("georef") is None
    PLUGIN = georef_qgis.classFactory(None)
    PLUGIN.initGui()
    return {
        "gone": gone,
        "problem": PLUGIN.provider.problem,
        "count": len(PLUGIN.provider.algorithms()),
    }


KINDS = {f.__name__: f for f in (algorithms, run, model, dialogs, picture, echo, reload)}


def main():
    """Do the jobs one by one; what fails is told with its traceback."""
    results = []
    for job in json.loads(Path(sys.argv[1]).read_text("utf-8")):
        started = time.monotonic()
        try:
            result = KINDS[job["kind"]](job)
        except Exception:
            result = {"ok": False, "log": traceback.format_exc(), "crashed": True}
        result["seconds"] = round(time.monotonic() - started, 2)
        results.append(result)
        Path(sys.argv[2]).write_text(json.dumps(results, default=str), encoding="utf-8")
    # QGIS 3.22 may crash while it is torn down; the results are written.
    sys.stdout.flush()
    os._exit(0)


main()
