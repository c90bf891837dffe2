#version 330 core
struct DirectionalLight { vec3 direction; };
struct Material { sampler2D base_color_texture; };
uniform DirectionalLight directional_lights[1];
uniform Material material;
uniform vec3 ambient_light, cam_pos;
in vec2 uv_0;
in vec3 point, face_normal, colour;
out vec4 frag_color;
void main() {
    vec4 texel = texture(material.base_color_texture, uv_0);
    if (texel.a * 255.0 < 128.0) discard;  // viewnet.render.raycast.ALPHA_CUT
    float side = dot(face_normal, cam_pos - point) < 0.0 ? -1.0 : 1.0;
    float diffuse = max(side * dot(normalize(face_normal), -directional_lights[0].direction), 0.0);
    frag_color = vec4(colour * texel.rgb * mix(ambient_light, vec3(1.0), diffuse), 1.0);
}
