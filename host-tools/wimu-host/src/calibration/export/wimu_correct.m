function @signature@
% @title@ MATLAB or Octave; save as wimu_correct.m.
%
@convention@
%
% output: n-by-3; force: n-by-3, m/s^2, body axes. temperature_c may be left out.
reference_c = @t0@;
input_to_mps2 = @scale@;
b0 = @b0@;
b1 = @b1@;
b2 = @b2@;
s1 = @s1@;
q = @q@;
a = @a@;
r = @r@;
if nargin < 2 || isempty(temperature_c), temperature_c = reference_c; end
dt = temperature_c - reference_c;
z = ((a .* (1 + diag(s1 * dt))) \ (output * input_to_mps2 - (b0 + (b1 + b2 * dt) * dt))')';
z = z - q .* z .* z;
force = z * r';
@gyroscope{
% rate_output: n-by-3, @wunit@; rate: n-by-3, rad/s, body axes.
rate = [];
if nargin < 3, return, end
dt = temperature_c - @wt0@;
wb0 = @wb0@;
wb1 = @wb1@;
ws1 = @ws1@;
wa = @wa@;
g = @wg@;
y = rate_output * @wscale@ - (wb0 + wb1 * dt) - z * g';
rate = ((wa .* (1 + diag(ws1 * dt))) \ y')' * r';
@}
end
