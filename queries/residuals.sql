-- Residuals by sensor and by day: is one sensor, or one day, off? A mean far from 0 (see `mean_in_sd`) is a delay that calibration missed;
-- a spread far above 1 is an error bar that is too small. A day is that of the capture's first shot, in the instrument's own zone.
SET VARIABLE results = 'results';

WITH days AS (
    SELECT campaign, sensor, lit, seen, acquired_at[1:10] AS day
    FROM read_parquet(getvariable('results') || '/profiles/*.parquet')
    WHERE role = 'scene'
)
SELECT campaign, sensor, day,
    count(*) AS onsets,
    avg(residual_ps) AS mean_ps,
    avg(residual_ps) / (stddev_samp(residual_ps) / sqrt(count(*))) AS mean_in_sd,
    sqrt(avg(standardised ** 2)) AS spread,
    count(*) FILTER (suspect OR NOT used) AS suspects
FROM read_parquet(getvariable('results') || '/patches.residuals/*.parquet') JOIN days USING (campaign, sensor, lit, seen)
GROUP BY campaign, sensor, day
ORDER BY campaign, sensor, day;
