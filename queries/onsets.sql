-- Onset statistics: how many arrivals there are of each number of bounces, how well they are timed, how far they stand out of the noise.
-- The label with alternative 0 is the likeliest path of an onset; 0 bounces: left unexplained. An onset that is read as two pulses counts as two.
SET VARIABLE results = 'results';

SELECT l.campaign, l.sensor, l.bounces,
    count(*) AS onsets,
    median(o.time_sd_ps) AS median_sd_ps,
    max(o.time_sd_ps) AS worst_sd_ps,
    median(o.snr) AS median_snr,
    min(o.snr) AS least_snr
FROM read_parquet(getvariable('results') || '/labels/*.parquet') l
JOIN read_parquet(getvariable('results') || '/onsets/*.parquet') o USING (campaign, sensor, lit, seen, rank)
WHERE l.alternative = 0
GROUP BY ALL
ORDER BY ALL;
