# SPDX-License-Identifier: Apache-2.0
"""The files that a study leaves for people and for other programs."""

from __future__ import annotations

import json
from pathlib import Path

from kbnitp_ros.study.charts import entropy_chart, log_loss_chart, reliability_chart
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.summary import markdown, summarise
from pyarrow import parquet


def write_report(results: Results, folder: Path) -> list[Path]:
    """
    Write the table, the figures and the summary of a study; the same results, the same table.

    Returns
    -------
    list of Path
        What was written.

    """
    names = 'table.parquet entropy.png log_loss.png reliability.png summary.json summary.md'
    table, entropy, log_loss, reliability, as_json, as_markdown = files = [
        folder / name for name in names.split()
    ]
    parquet.write_table(results.table(), table)
    entropy_chart(entropy, results)
    log_loss_chart(log_loss, results)
    reliability_chart(reliability, results)
    summary = summarise(results)
    as_json.write_text(json.dumps(summary, indent=1) + '\n')
    as_markdown.write_text(markdown(summary))
    return files
