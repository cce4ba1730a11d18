"""Metadata of a dataset in Croissant 1.1 of MLCommons (JSON-LD)."""

from pathlib import Path

import pyarrow as pa

from angler_mjx.files import JsonTable
from angler_mjx.learning.datasets.index import SCHEMA
from angler_mjx.learning.datasets.manifest import INDEX, SUMS, Manifest
from angler_mjx.runs.storage.checksums import hash_file

_CONTEXT: JsonTable = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


def build_metadata(root: Path, manifest: Manifest) -> JsonTable:
    """Build the dataset's ``croissant.json``.

    Args:
        root: folder of the dataset, with its index.
        manifest: its manifest.
    """
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": manifest.name,
        "description": manifest.description or f"{manifest.episodes} flights of underwater robots",
        "license": manifest.licence,
        "url": f"https://example.org/{manifest.name}",
        "datePublished": manifest.created[:10],
        "version": "1.0.0",
        "citeAs": f"{manifest.name}, made with angler-mjx",
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": "folder",
                "name": "folder",
                "description": "The dataset's folder.",
                "contentUrl": "./",
                "encodingFormat": "local/folder",
                "sha256": "https://github.com/mlcommons/croissant/issues/80",
            },
            {
                "@type": "cr:FileObject",
                "@id": "index",
                "name": "index",
                "description": "A row an episode.",
                "contentUrl": INDEX,
                "encodingFormat": "application/x-parquet",
                "sha256": hash_file(root / INDEX),
            },
            {
                "@type": "cr:FileSet",
                "@id": "robots",
                "name": "robots",
                "description": "A row a robot, a file a part.",
                "containedIn": {"@id": "folder"},
                "encodingFormat": "application/x-parquet",
                "includes": "runs/*/episodes.parquet",
            },
            {
                "@type": "cr:FileSet",
                "@id": "trajectories",
                "name": "trajectories",
                "description": f"Zarr v3 groups, a part each; their sums stand in {SUMS}.",
                "containedIn": {"@id": "folder"},
                "encodingFormat": "application/vnd.zarr; version=3",
                "includes": "runs/*/trajectories.zarr/**",
            },
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "episodes",
                "name": "episodes",
                "description": "Flights of a team, one each.",
                "key": {"@id": "episodes/episode"},
                "field": [_describe_field(field) for field in SCHEMA],
            }
        ],
    }


def _describe_field(field: pa.Field) -> JsonTable:
    metadata = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
    unit = f" ({metadata['unit']})" if metadata.get("unit", "1") not in ("", "1") else ""
    return {
        "@type": "cr:Field",
        "@id": f"episodes/{field.name}",
        "name": field.name,
        "description": metadata["description"] + unit,
        "dataType": _data_type(field.type),
        "source": {"fileObject": {"@id": "index"}, "extract": {"column": field.name}},
    }


def _data_type(dtype: pa.DataType) -> str:
    if pa.types.is_boolean(dtype):
        return "sc:Boolean"
    if pa.types.is_integer(dtype):
        return "sc:Integer"
    if pa.types.is_floating(dtype):
        return "sc:Float"
    return "sc:Text"
