-- The same onset in two campaigns of one scene (two days, in one result folder): how far its time changed, in ps and in standard deviations.
-- What all onsets of a profile share (`jitter_ps`) counts on both days; the latency's own error, common to all onsets of a day, does not.
SET VARIABLE results = 'results';
SET VARIABLE one = 'monday';
SET VARIABLE other = 'tuesday';

WITH onsets AS (
    SELECT campaign, sensor, lit, seen, rank, time_ps, time_sd_ps ** 2 + jitter_ps ** 2 AS var_ps2
    FROM read_parquet(getvariable('results') || '/onsets/*.parquet')
)
SELECT a.sensor, a.lit, a.seen, a.rank, b.time_ps - a.time_ps AS later_ps, sqrt(a.var_ps2 + b.var_ps2) AS sd_ps,
    (b.time_ps - a.time_ps) / sqrt(a.var_ps2 + b.var_ps2) AS in_sd
FROM onsets a JOIN onsets b USING (sensor, lit, seen, rank)
WHERE a.campaign = getvariable('one') AND b.campaign = getvariable('other')
ORDER BY a.sensor, a.lit, a.seen, a.rank;
