//! Result folders: their tables as Arrow streams, origins of rows, and the report.

mod columns;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{RecordBatch, RecordBatchIterator, RecordBatchReader};
use arrow_schema::{ArrowError, SchemaRef};
use periscope::history::explanation::explain;
use periscope::history::target::Target;
use periscope::report::{Report, figures, page};
use periscope::store::{FileRecord, Shelf, StoreError, parquet, scan};
use periscope::tables;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::failure::{ResultsError, of_history, of_store};

/// Rows of a batch of a stream.
const BATCH_ROWS: usize = 8192;

/// A result folder, native part; `periscope.Results` is for users.
#[pyclass(frozen, subclass, module = "periscope")]
pub struct Results {
    shelf: Shelf,
}

#[pymethods]
impl Results {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        Shelf::look(&path).map(|shelf| Self { shelf }).map_err(of_store)
    }

    /// The result folder.
    #[getter]
    fn path(&self) -> PathBuf {
        self.shelf.out().to_owned()
    }

    /// Names of the tables.
    #[getter]
    fn tables(&self) -> PyResult<Vec<String>> {
        self.shelf.names().map_err(of_store)
    }

    /// A table by its name. Rows are read when a stream is.
    fn __getitem__(&self, py: Python<'_>, name: &str) -> PyResult<Table> {
        let names = self.tables()?;
        if !names.iter().any(|other| other == name) {
            let problem = format!("{} has no table {name:?}; it has {names:?}", self.shelf.out().display());
            return Err(PyKeyError::new_err(problem));
        }
        py.detach(|| Table::of(&self.shelf, name))
    }

    /// Origins of a row as a JSON text.
    fn explain_json(
        &self,
        py: Python<'_>,
        row: &str,
        table: Option<String>,
        campaigns: Vec<PathBuf>,
    ) -> PyResult<String> {
        let target: Target = row.parse().map_err(PyValueError::new_err)?;
        let explanation =
            py.detach(|| explain(&self.shelf, &target, table.as_deref(), &campaigns)).map_err(of_history)?;
        serde_json::to_string(&explanation).map_err(|error| ResultsError::new_err(error.to_string()))
    }

    /// Whether the answer is to be believed: in a word, as the report has it, and the reasons.
    #[getter]
    fn verdict(&self, py: Python<'_>) -> PyResult<(&'static str, Vec<String>)> {
        let report = py.detach(|| Report::of(self.shelf.out())).map_err(of_history)?;
        let (word, reasons) = report.verdict();
        Ok((word, reasons.to_vec()))
    }

    /// The report as the text of an HTML page.
    fn report_html(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| Report::of(self.shelf.out()).map(|report| page::page(&report))).map_err(of_history)
    }

    /// Figures of the report as SVG texts, by name.
    fn figures(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, String)>> {
        let report = py.detach(|| Report::of(self.shelf.out())).map_err(of_history)?;
        py.detach(|| figures::all(&report)).map_err(|error| ResultsError::new_err(error.to_string()))
    }
}

/// A table of a result folder.
///
/// It streams through the Arrow PyCapsule interface: `polars.DataFrame(table)`, `pyarrow.table(table)`,
/// `pandas.DataFrame.from_arrow(table)` and DuckDB take it as it is. Each stream reads the files anew, part by part.
#[pyclass(frozen, module = "periscope")]
pub struct Table {
    name: String,
    schema: SchemaRef,
    files: Arc<[(PathBuf, FileRecord)]>,
    rows: u64,
}

impl Table {
    fn of(shelf: &Shelf, name: &str) -> PyResult<Self> {
        let files = shelf.recorded(name).map_err(of_store)?;
        let schema = if let Some((path, _)) = files.first() {
            scan::schema(path).map_err(of_store)?
        } else {
            // A table without rows may have no file; its kind says what it would hold.
            let kind = shelf.table_of(name).map_err(of_store)?.unwrap_or_else(|| name.to_owned());
            let unlisted =
                || ResultsError::new_err(format!("table {name} has no file, and {kind} is no kind of table"));
            tables::schema_of(&kind).ok_or_else(unlisted)?
        };
        let rows = files.iter().map(|(_, record)| record.rows).sum();
        Ok(Self { name: name.to_owned(), schema, files: files.into(), rows })
    }

    /// The rows, file by file.
    fn reader(&self) -> Box<dyn RecordBatchReader + Send> {
        let files = Arc::clone(&self.files);
        let batches = (0..files.len()).flat_map(move |n| {
            let (path, record) = &files[n];
            batches(path, record)
        });
        Box::new(RecordBatchIterator::new(batches, Arc::clone(&self.schema)))
    }
}

/// The batches of a file; of a damaged one, its error.
fn batches(path: &Path, record: &FileRecord) -> Box<dyn Iterator<Item = Result<RecordBatch, ArrowError>> + Send> {
    let external = |error: StoreError| ArrowError::ExternalError(Box::new(error));
    match parquet::read_recorded(path, record, BATCH_ROWS) {
        Ok(batches) => Box::new(batches.map(move |batch| batch.map_err(external))),
        Err(error) => Box::new(std::iter::once(Err(external(error)))),
    }
}

#[pymethods]
impl Table {
    /// Name of the table.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Names of the columns. `periscope schema` prints what they hold.
    #[getter]
    fn columns(&self) -> Vec<&str> {
        self.schema.fields().iter().map(|field| field.name().as_str()).collect()
    }

    /// A column as an array: numbers of their type (with NaN where values are missing), else objects: texts, arrays
    /// where each row has a list, and None.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///     One of `columns`.
    ///
    /// Raises
    /// ------
    /// KeyError
    ///     If there is no such column.
    /// ResultsError
    ///     If a file is damaged.
    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let place = self.schema.index_of(name).map_err(|_| {
            let columns = self.columns();
            PyKeyError::new_err(format!("table {} has no column {name:?}; it has {columns:?}", self.name))
        })?;
        let read = || {
            let column = |batch: Result<RecordBatch, ArrowError>| Ok(Arc::clone(batch?.column(place)));
            self.reader().map(column).collect::<Result<Vec<_>, ArrowError>>()
        };
        let parts = py.detach(read).map_err(|error| ResultsError::new_err(format!("table {}: {error}", self.name)))?;
        columns::array(py, name, self.schema.field(place).data_type(), &parts)
    }

    /// The rows as an Arrow stream: the protocol of the Arrow PyCapsule interface. Types are those of the table,
    /// whatever schema is asked for.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema; // the protocol lets a producer keep its own types
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(self.reader()), c"arrow_array_stream")
    }

    fn __len__(&self) -> usize {
        self.rows as usize
    }

    fn __repr__(&self) -> String {
        format!("<Table {}: {} rows, {} columns>", self.name, self.rows, self.schema.fields().len())
    }
}
